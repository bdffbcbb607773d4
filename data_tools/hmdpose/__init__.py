"""Recordings of AR glasses by three infrared cameras, in a layout of this project.

HMDPose (Firintepe et al., "HMDPose: A large-scale trinocular IR augmented reality glasses pose
dataset", 2020) has 14 subjects who wear 4 glasses, seen from the left, the centre and the right in
images of 1280 x 752 pixels. It is given out on request, and how its files lie is not public; so
whoever has them brings them into this layout first:

    PATH/calibration.json             the three cameras
    PATH/SPLIT/poses.csv              one row for each instant
    PATH/SPLIT/left/000012.png        grey, 8 or 16 bits; also centre/ and right/
    PATH/models/obj_000001.ply, models_info.json        the glasses; optional, as in BOP

`calibration.json`: of each of "left", "centre" and "right" the camera matrix `K` and the pose of
the camera in the car `T_world_cam` (metres), row by row, and the size of its images, which have no
distortion:

    {"cameras": {"left": {"K": [9 numbers], "T_world_cam": [16 numbers], "width": 1280,
                          "height": 752}, "centre": {...}, "right": {...}}}

`poses.csv`: where the glasses are in the car. `frame` is the number in the names of the three
images and occurs once; `glasses` is 1 to 4; metres, and a unit quaternion that turns the glasses'
axes into the car's:

    frame,subject,glasses,x,y,z,qw,qx,qy,qz
    12,3,1,0.01,-0.02,0.05,1,0,0,0

Labels that no recording has, but a drawn world; each may be missing:

    PATH/SPLIT/masks/glasses/left/000012.png            not black where they are seen
    PATH/SPLIT/masks/head/left/000012.png               and the head that wears them
    PATH/SPLIT/full_masks/...                           where nothing else stood before them
    PATH/SPLIT/depth/left/000012.png                    16 bits, 0 for none; "depth_step", metres,
                                                        stands beside "cameras"
    PATH/SPLIT/labels.csv                               one row for each object of each image:

    frame,camera,object,box_x,box_y,box_width,box_height,visible_fraction,size_x,size_y,size_z
    12,left,glasses,30,20,14,5,0.98,0.15,0.05,0.16

A box in pixels, the share that is seen and the extent in metres; what is not known is empty.
"""

from data_tools.hmdpose.dataset import HmdposeDataset
from data_tools.hmdpose.writing import write_hmdpose

__all__ = ["HmdposeDataset", "write_hmdpose"]
