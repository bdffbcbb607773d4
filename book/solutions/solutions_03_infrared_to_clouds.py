# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: Infrared to clouds
#
# They need what [chapter 03](../03_infrared_to_clouds.ipynb) explains.

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**

# %% [markdown]
# **How it works**
#
# - Replace the line `...  # your code here`, run the cell, then run the check below it.
# - If it is not right, the check shows the first input where your answer differs, and a hint. The
#   arguments are `answer.inputs`: call your function with them, `f(*answer.inputs)`, in a cell of
#   your own.
# - The page always goes on: the name that ends in `_here` is your function if it is done, and the
#   library's if not.

# %%
import numpy as np

from book.ch03_infrared_to_clouds import checks
from book.tools.checks import use
from book.tools.syntax import forgive_syntax

forgive_syntax()  # a cell that is no Python says so, and the page goes on

# %% [markdown]
# ## 1. A translation from a pixel
#
# | in | shape | |
# |---|---|---|
# | `K` | (3, 3) | camera matrix, perhaps with skew |
# | `pixel` | (2,) | where a point is seen |
# | `z` | | how far in front of the camera it is, metres |
# | **out** | (3,) | the point, metres |


# %%
def translation(K, pixel, z):
    """The point that is seen at a pixel.

    >>> translation(np.eye(3), np.array([0.5, -1]), 2.0).tolist()
    [1.0, -2.0, 2.0]
    """
    ### BEGIN SOLUTION
    return z * np.linalg.inv(K) @ [*pixel, 1]
    ### END SOLUTION


# %%
answer = checks.check_translation(translation)
translation_here = use(answer, checks.translation)
answer

# %% [markdown]
# The same pixel, twice as far: all of $t$ doubles.

# %%
K = np.array([[500.0, 0, 320], [0, 400, 240], [0, 0, 1]])
near, far = (translation_here(K, np.array([100.0, 50]), z) for z in (1.0, 2.0))
assert np.allclose(far, 2 * near)
