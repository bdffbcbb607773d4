# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # 6-DoF object pose estimation: the book that you can run
#
# A camera looks at an object. Where is the object, and how is it turned? Six numbers answer: three
# for the place, three for the turn. They are called its **pose**, and a robot that wants to grasp,
# a headset that wants to draw and a car that watches its driver all need it.
#
# This book builds five research papers on that question, step by step, in notebooks that run on a
# laptop without a GPU and without a network. Nothing is downloaded: small worlds are drawn by the
# book itself, and every number that we measured was printed by a cell beside it.

# %%
from book.ch00_index.drawing import the_map as draw

draw.map_of_the_book()

# %% [markdown]
# Five papers are five roads to the same place. They differ in what they look at, in what they ask a
# network to say, and in what geometry does with the answer. A network that says the pose itself
# needs no geometry. One that says something easier, such as a vector per pixel, leaves the rest to
# a solver. Which is better, and when? The last chapter lets all of them compete.
#
# ## The papers
#
# | short name | paper | chapters |
# |---|---|---|
# | the infrared paper | [Firintepe et al., 2021](https://doi.org/10.3390/jimaging7050080), *From IR Images to Point Clouds to Pose: Point Cloud-Based AR Glasses Pose Estimation* | 3, 4 |
# | CIPE | [Ren et al.](https://github.com/jialeren/CIPE), *A Unified End-to-end Network for Category-level and Instance-level Object Pose Estimation from RGB Images* | 5, 6 |
# | the rotation-invariant paper | Chen et al., a rotation-invariant 3D convolutional network (the copy that we read bears no title) | 7 |
# | the projection-loss paper | You et al., 2021, *Object Pose Estimation Incorporating Projection Loss and Discriminative Refinement* | 8 |
# | the colour-refinement paper | [Huang et al., 2020](https://doi.org/10.3390/s20154114), *Iterative Pose Refinement for Object Pose Estimation Based on RGBD Data* | 9 |
#
# The projection-loss paper builds on **PVNet**, the colour-refinement paper on **DenseFusion**, two
# older methods that the book builds first.
#
# ## The pages
#
# | | page | what you build |
# |---|---|---|
# | 1 | [Poses and cameras](01_poses_and_cameras.ipynb) | a pose, a camera, three classical solvers, and every metric of the five papers |
# | 2 | [Three small worlds](02_small_worlds.ipynb) | a renderer from one triangle on, and the data of all later chapters |
# | 3 | [Infrared to clouds](03_infrared_to_clouds.ipynb) | a point cloud from one infrared image |
# | 4 | [From a cloud to a pose](04_points_to_pose.ipynb) | PointNet++, voting, and the pose of AR glasses on a head |
# | 5 | [Learnable rotations](05_learnable_rotations.ipynb) | what numbers a network should say for a rotation |
# | 6 | Poses as sets | all objects of an image at once |
# | 7 | Rotation invariance | features that do not change when the object turns |
# | 8 | [Vector fields](08_vector_fields.ipynb) | PVNet, a loss in pixels, and knowing when to refine |
# | 9 | Colour-aware refinement | DenseFusion, improved step by step |
# | 10 | The arena | every method on one test |
#
# Pages without a link are being written. Each chapter has exercises, and each exercise has a check
# that answers at once: those of chapters [1](exercises/exercises_01_poses_and_cameras.ipynb),
# [2](exercises/exercises_02_small_worlds.ipynb), [3](exercises/exercises_03_infrared_to_clouds.ipynb),
# [4](exercises/exercises_04_points_to_pose.ipynb),
# [5](exercises/exercises_05_learnable_rotations.ipynb) and
# [8](exercises/exercises_08_vector_fields.ipynb), and their solutions,
# [1](solutions/solutions_01_poses_and_cameras.ipynb), [2](solutions/solutions_02_small_worlds.ipynb),
# [3](solutions/solutions_03_infrared_to_clouds.ipynb),
# [4](solutions/solutions_04_points_to_pose.ipynb),
# [5](solutions/solutions_05_learnable_rotations.ipynb) and [8](solutions/solutions_08_vector_fields.ipynb).
#
# ## How to run it
#
# In a virtual environment with Python 3.11, at the top of the project:
#
# ```
# pip install -r environment.txt && python book/make.py read
# ```
#
# `read` opens JupyterLab at this page (`read 05`: at chapter 5) and turns off that it saves by itself:
# pages that you run stay as they are. Save what you want to keep.
#
# Open a chapter, run its cells from the top, change a number, run again. For the exercises, take a
# copy that no update will touch:
#
# ```
# python book/make.py start 01
# ```
#
# It is `book/my_work/my_01_poses_and_cameras.ipynb` then. An exercise that you leave unfinished never
# stops the page: from there on the page uses the library's version.
#
# Three settings in the environment change how the pages run. Give them before Jupyter starts; on
# Linux and macOS: `POSECORE_SCALE=tiny python book/make.py read`.
#
# | variable | values | effect |
# |---|---|---|
# | `POSECORE_SCALE` | `tiny`, `book` (default), `paper` | how much data and training; the code is the same |
# | `POSECORE_DATA` | a folder | real data of the field, which the pages then show |
# | `POSECORE_RETRAIN` | `1` | train where a stored network would be loaded |

# %%
from posecore.scale import scale

print("This page runs at scale:", scale())

# %% [markdown]
# ## What the papers claim, and what we measured
#
# Every claim of a paper that the book could measure is a row here: the paper's numbers, ours with
# their spread over seeds, and a verdict by a fixed rule. Take the difference of the two sides in
# each seed, in the direction that the paper claims, and the 95 % interval of its mean (Student's).
# The claim **holds** if all of the interval lies on the paper's side of zero. It is **contradicted
# here**, on our small worlds, if all of it lies on the other side. And it is **undecided** if the
# interval contains zero; such a row says how large a difference would have been seen. A claim that
# two things are *equal* comes with a margin, from the paper's own numbers, and holds if the interval
# lies within it. Rows that say "our own question" ask what the paper does not. And a row is marked
# *stale*, with the reason, when something that it was measured with has changed since.

# %%
from book.tools.claims import ledger_table
from book.tools.ledger import all_rows

ledger_table(all_rows())

# %% [markdown]
# ## Notation
#
# | written | in code | is |
# |---|---|---|
# | $R$ | `R`, (..., 3, 3) | rotation from the object's frame to the camera's |
# | $t$ | `t`, (..., 3) | translation: the object's origin as the camera sees it, in metres |
# | $X_\mathrm{cam} = R\,X_\mathrm{obj} + t$ | `poses.apply` | what a pose does to a point |
# | $K$ | `K`, (..., 3, 3) | camera matrix, from metres in front of the camera to pixels |
# | $q = (w, x, y, z)$ | `q`, (..., 4) | unit quaternion, real part first |
# | $\hat R, \hat t$ | `R_est`, `t_est` | an estimate |
# | $d$ | `diameter` | the largest distance between two points of an object |
#
# The camera looks along $z$; $x$ points right and $y$ down. The centre of the first pixel is
# $(0, 0)$. Lengths are metres and angles radians; degrees and millimetres appear in figures and
# tables, which say so. `...` stands for any number of batch dimensions.
#
# ## Glossary
#
# | word | meaning |
# |---|---|
# | **6-DoF pose** | rotation and translation, three degrees of freedom each |
# | **instance level** | the very object is known beforehand, often as a mesh |
# | **category level** | only its kind is known: a mug, though not which; its size is estimated too |
# | **object frame** | the coordinates of the object's own model, origin often in its middle |
# | **keypoint** | a chosen point of the model that is looked for in the image |
# | **PnP** | perspective-n-point: the pose from points of the model and their pixels |
# | **RANSAC** | solve from few matches many times, keep the solution that most others agree with |
# | **ICP** | iterative closest point: match nearest points, align, repeat |
# | **Umeyama** | the best rotation, translation and scale between two matched clouds |
# | **ADD, ADD-S** | mean distance of the model's points between two poses; to the nearest point |
# | **AUC** | area under the curve of accuracy against threshold |
# | **AP** | average precision: area under precision against recall |
# | **ground truth** | the pose that one believes in when one measures an estimate |
# | **BOP** | a benchmark of the field, whose files this book reads and writes |
# | **LINEMOD, LM-O** | photographs of small things with measured poses; LM-O is short for Occlusion-LINEMOD, where things hide each other |
# | **YCB-Video** | videos of 21 things from a shop, with measured poses |
# | **NOCS** | a data set of kinds of things (category level), and the code that most tables on it were made with |
# | **HMDPose** | infrared films of drivers with AR glasses, seen by three cameras |
# | **object coordinates** | for each pixel the point of the object that it shows, in the object's own frame; scaled to a diagonal of 1: a NOCS map |
# | **z-buffer** | for each pixel the depth of the nearest thing drawn so far |
# | **visible fraction** | pixels in which an object is seen, over all pixels of its silhouette |
# | **augmentation** | varying a picture each time that a network sees it, its ground truth with it |
#
# Next: [chapter 1, poses and cameras](01_poses_and_cameras.ipynb).
