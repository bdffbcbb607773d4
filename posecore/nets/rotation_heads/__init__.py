"""How a network says a rotation: representations and losses by name, and the learnable codec."""

from posecore.nets.rotation_heads.codec import (
    RotationCodec,
    load_codec,
    save_codec,
    train_codec,
)
from posecore.nets.rotation_heads.decoders import (
    decode_6d,
    decode_axis_angle,
    decode_euler,
    decode_procrustes,
    decode_quaternion,
)
from posecore.nets.rotation_heads.heads import LOSSES, REPRESENTATIONS, RotationHead

__all__ = [
    "LOSSES",
    "REPRESENTATIONS",
    "RotationCodec",
    "RotationHead",
    "decode_6d",
    "decode_axis_angle",
    "decode_euler",
    "decode_procrustes",
    "decode_quaternion",
    "load_codec",
    "save_codec",
    "train_codec",
]
