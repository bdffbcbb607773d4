# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Infrared to clouds
#
# ## The question in one picture

# %%
import torch
from posecore.methods.infrared_to_clouds.network import translation
from posecore.methods.infrared_to_clouds.recipe import RECIPES, train

from book.ch03_infrared_to_clouds import experiments
from book.ch03_infrared_to_clouds.drawing import figures as draw
from posecore import cameras, figures
from posecore.scale import scale

torch.set_num_threads(1)  # for such small networks, more would be slower
test = experiments.seen("easy")
figures.pose_picture(test.images[0].permute(1, 2, 0), test.K[0], test.R[0], test.t[0])

# %% [markdown]
# Somewhere on this table stands a teapot; its axes are drawn in. Can a network say its pose
# outright, from the pixels?
#
# ## What you will build, and what you need
#
# | | you build | the library has it as |
# |---|---|---|
# | 1 | a translation from a pixel and a distance | `infrared_to_clouds.network.translation` |
# | 2 | a trained network | `infrared_to_clouds.recipe.train` |
#
# You need chapter 1's camera.
#
# - **Time:** ten minutes to read, one to run.
# - **Short path:** section 1, and the picture at the end of section 2.
#
# Symbols of this page, each of which has one meaning:
#
# | symbol | in code | is |
# |---|---|---|
# | $(u, v)$ | `pixel` | where the object's origin is seen, pixels |
# | $z$ | `z` | how far in front of the camera it is, metres |
#
# ## 1. A pixel and a distance make a translation
#
# What a network sees of $t$ is where the object is in the image, and how large. So let it say
# just that: a pixel and a distance. With $f_x, f_y, c_x, c_y$ from $K$,
#
# $$ t = z \left(\frac{u - c_x}{f_x},\; \frac{v - c_y}{f_y},\; 1\right). $$


# %%
def from_pixel(K, pixel, z):
    """t (3,) of one object."""
    u, v = pixel
    return torch.stack([z * (u - K[0, 2]) / K[0, 0], z * (v - K[1, 2]) / K[1, 1], z])


pixel = torch.stack([cameras.project(K, t[None])[0] for K, t in zip(test.K, test.t, strict=True)])
mine = [from_pixel(*one) for one in zip(test.K, pixel, test.t[:, 2], strict=True)]
assert torch.allclose(torch.stack(mine), test.t, atol=1e-5)
assert torch.allclose(translation(test.K, pixel, test.t[:, 2]), test.t, atol=1e-5)

# %% [markdown]
# <details><summary>Why not let the network say the three numbers of t?</summary>
#
# In an image from another camera the same pixels belong to another $t$. The pixel and the distance
# leave $K$ to the formula, which knows it.
#
# </details>
#
# ## 2. Train it
#
# To train is to make a **loss** small by following its gradient. The images that the network
# learns from are others than those it is tested on.

# %%
net, history = train(experiments.seen("train"), RECIPES[scale()])

# %%
with torch.no_grad():
    R, t = net(test.images, test.K)
loss = history.losses["loss"]
assert sum(loss[-5:]) < sum(loss[:5])
draw.distances(test.t[:, 2].numpy(), t[:, 2].numpy())

# %% [markdown]
# <details><summary>The loss fell. Does that show that the network has learned to see?</summary>
#
# No. It falls as soon as the network knows where teapots usually stand. The dots would then lie on
# a level line: one distance for every image.
#
# </details>
#
# ## 3. What the paper claims and what we measured
#
# Is that more than to know where teapots usually stand? Three networks, from other weights and on
# other batches:

# %%
from book.tools.claims import ledger_table
from book.tools.ledger import all_rows

ledger_table(all_rows().get("03_infrared_to_clouds", []))

# %% [markdown]
# <details><summary>What does "undecided" say of a claim?</summary>
#
# That the interval of the difference holds 0: these seeds cannot tell the two apart. It does not
# say that both are equally good.
#
# </details>
#
# ## Exercises
#
# [The exercises](exercises/exercises_03_infrared_to_clouds.ipynb); get your own copy with `python book/make.py start 03`.
# [Solutions](solutions/solutions_03_infrared_to_clouds.ipynb).
#
# ## Summary
#
# - A translation is a pixel and a distance; the camera does the rest.
#
# ## Appendix: reading the paper closely
#
# What is printed, what is wrong or left open in it, and how the book reads it: a row each, and a
# short cell where that needs showing. The sections above link here from where it matters.
#
# | where | is printed | the book reads it as |
# |---|---|---|
# | Eq. 1 | $t$, in no unit | metres |
