"""What surfaces look like: procedural patterns evaluated on object coordinates."""

from data_tools.textures.patterns import PATTERNS, albedo, infrared

__all__ = ["PATTERNS", "albedo", "infrared"]
