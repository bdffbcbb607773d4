# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: learnable rotations
#
# Five functions for you to write, from a warm-up to an open question.
# They need PyTorch, and what [chapter 5](../05_learnable_rotations.ipynb) explains.

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 05` puts it into `book/my_work/`.

# %% [markdown]
# **How it works**
#
# - Replace the line `...  # your code here`, run the cell, then run the check below it.
# - A check says *done*, *not done yet* or *not right yet*. If it is not right, the check shows the
#   first input where your answer differs, and a hint. The next try brings the second hint.
# - The page always goes on: after a check, the name that ends in `_here` is your function if it is
#   done, and the library's if not. So try the exercises in any order.
# - Keep the functions' names. To look at what yours does, add a cell of your own (`Esc`, then `B`)
#   and call it as the example in its docstring does.
# - `answer.inputs` are the arguments of that first input, `answer.expected` and `answer.got` the two
#   results: call your function with them, `f(*answer.inputs)`, to see what it does there.
#
# All numbers are torch tensors, and all inputs of the checks are `float64`.

# %%
import numpy as np
import torch
from torch import nn

from book.ch05_learnable_rotations import checks
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from posecore import figures, rotations
from posecore.figures.style import COLOURS, STYLES
from posecore.nets.rotation_heads import RotationHead
from posecore.scale import choose, scale

forgive_syntax()  # a cell that is no Python says so, and the page goes on
generator = torch.Generator().manual_seed(0)
torch.set_default_dtype(torch.float64)

# %% [markdown]
# ## 1. Warm-up: the rotation nearest to a matrix
#
# A network says nine numbers, a matrix $M$. Its answer is the rotation that is nearest to $M$. The
# paper's Eq. 2 takes the singular value decomposition $M = U S V^T$ and says $R = U V^T$.
# That is the nearest *orthogonal* matrix. It may be a reflection. Mend that.
#
# | in | shape | |
# |---|---|---|
# | `M` | (N, 3, 3) | any finite matrices; N may be 0 |
# | **out** | (N, 3, 3) | for each the rotation with the least distance $\lVert R - M \rVert$ |
#
# - A network may say a flat matrix, whose determinant is 0. It has a nearest rotation, too.
# - If several rotations are equally near, any of them is right.
#
# The picture shows what is expected for 300 random matrices. A rotation is never nearer to $M$ than
# $U V^T$ is. Where $U V^T$ is a rotation already, nothing changes: these lie on the line.

# %%
M = torch.randn(300, 3, 3, generator=generator)
U, S, Vh = torch.linalg.svd(M)
mirrors = torch.linalg.det(U @ Vh) < 0
to_orthogonal = torch.linalg.matrix_norm(M - U @ Vh)
to_rotation = torch.linalg.matrix_norm(M - checks.nearest_rotation(M))

# %%
rows = {"U Vᵀ is a rotation": ~mirrors, "U Vᵀ mirrors": mirrors}
figures.chart(
    {"_the same": (to_orthogonal, to_orthogonal)},
    marks={label: (to_orthogonal[some], to_rotation[some]) for label, some in rows.items()},
    looks={label: {"ms": 4, "mfc": "none"} for label in rows} | {"_the same": {"color": "0.7"}},
    xlabel="distance from M to U Vᵀ",
    ylabel="distance from M to the rotation, expected",
    size=(5.2, 4.2),
    alt="Distances of random matrices: half of them lie on the diagonal, the mirrors above it",
)


# %%
def nearest_rotation(M):
    """The rotations (N, 3, 3) nearest to matrices (N, 3, 3).

    >>> torch.linalg.det(nearest_rotation(-torch.eye(3)[None]))
    tensor([1.])
    """
    ### BEGIN SOLUTION
    U, _, Vh = torch.linalg.svd(M)
    d = torch.linalg.det(U @ Vh)  # (N,), -1 where U V^T mirrors
    D = torch.diag_embed(torch.stack([torch.ones_like(d), torch.ones_like(d), d], -1))
    return U @ D @ Vh
    ### END SOLUTION


# %%
answer = checks.check_nearest_rotation(nearest_rotation)
nearest_rotation_here = use(answer, checks.nearest_rotation)
answer

# %% [markdown]
# How often was the mending needed? And what does it cost?

# %%
R = nearest_rotation_here(M)
assert rotations.is_rotation(R).all()
extra = torch.linalg.matrix_norm(M - R) ** 2 - to_orthogonal**2
print(f"{mirrors.double().mean():.0%} of the random matrices mirror")
print(f"the squared distance grows by {extra[mirrors].mean():.2f} where they do,")
print(f"by {extra[~mirrors].abs().max():.0e} where they do not")
assert torch.allclose(extra[mirrors], 4 * S[mirrors, 2])

# %% [markdown] tags=["solution"]
# **Discussion.** The squared distance from $M$ to $U D V^T$ is $\sum_i (S_i - D_{ii})^2$, so a sign
# costs $4 S_i$. It is cheapest where $S_i$ is smallest, in the last place. The sign must be that
# of $\det(U V^T)$. That of $\det M$ is the same as long as $M$ is not flat; for a flat $M$ it is 0,
# and the result has a column of zeros.

# %% [markdown]
# ## 2. The gradient, against finite differences
#
# Chapter 5 found how the nearest rotation $R = U D V^T$ changes when $M$ changes a little:
#
# $$dR = U\,W\,D\,V^T \qquad W_{ij} = \frac{X_{ij} - X_{ji}}{s_i + s_j} \qquad X = U^T\,dM\,V\,D$$
#
# with $D = \operatorname{diag}(1, 1, \det U V^T)$ and $s = (S_1, S_2, D_{33} S_3)$. Training asks the
# other way round. It knows how the loss $L$ changes with $R$, the matrix
# $G = \partial L / \partial R$. It needs $\partial L / \partial M$, so that for every $dM$
#
# $$\sum_{ij} G_{ij}\, dR_{ij} = \sum_{ij} \frac{\partial L}{\partial M_{ij}}\, dM_{ij}$$
#
# The chapter's code for it divides by zero at a flat matrix, where $s_3 = 0$. Yet a flat matrix has
# one nearest rotation, and that moves smoothly. Write a gradient that is right there, too.
#
# | in | shape | |
# |---|---|---|
# | `M` | (3, 3) | a matrix with one nearest rotation: $s_2 + s_3 > 0$ |
# | `G` | (3, 3) | gradient of the loss with respect to $R$ |
# | **out** | (3, 3) | gradient of the loss with respect to $M$ |
#
# Do not leave it to autograd: through the SVD it says NaN where two singular values are equal, and
# wrong digits where they nearly are. Every rotation is such a matrix.
#
# The picture shows what is expected. We walk from $M$ in some direction. The slope of the dashed
# line is made of the gradient alone, and the line touches the loss. On the left $M$ is a random
# matrix, on the right a rotation.

# %%
G = torch.randn(3, 3, generator=generator)
dM = torch.randn(3, 3, generator=generator)
starts = {"random matrix": M[0], "rotation": R[0]}

# %%
figure = figures.Picture(figsize=(7.4, 3.2), layout="constrained")
figure.alt = "The loss along a line through M, twice, with its tangent at M"
for axes, (title, start) in zip(figure.subplots(1, 2), starts.items(), strict=True):
    h = torch.linspace(-0.5, 0.5, 101)
    L = (G * checks.nearest_rotation(start + h[:, None, None] * dM)).sum((1, 2))
    slope = (checks.procrustes_gradient(start, G) * dM).sum()
    axes.plot(h, L, label="loss")
    axes.plot(h, L[50] + h * slope, "--", color=COLOURS[1], label="from the gradient")
    axes.plot(0, L[50], "ko")
    axes.set(title=title, xlabel="step along dM")
figure.axes[0].set_ylabel("L, sum of G R")
figure.axes[0].legend()
figure


# %%
def procrustes_gradient(M, G):
    """The gradient (3, 3) of a loss at M, from its gradient G (3, 3) at the nearest rotation.

    >>> G = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
    >>> procrustes_gradient(2 * torch.eye(3), G)
    tensor([[ 0.0000, -0.5000,  0.0000],
            [ 0.5000,  0.0000,  0.0000],
            [ 0.0000,  0.0000,  0.0000]])
    """
    ### BEGIN SOLUTION
    U, S, Vh = torch.linalg.svd(M)
    d = torch.linalg.det(U @ Vh)
    D = torch.diag(torch.stack([torch.ones_like(d), torch.ones_like(d), d]))
    s = S * D.diagonal()
    Y = U.T @ G @ Vh.T @ D
    sums = s[:, None] + s[None, :]
    sums.fill_diagonal_(1)  # the numerator is 0 there, but 0 / 0 would not be
    Z = (Y - Y.T) / sums
    return U @ Z @ D @ Vh
    ### END SOLUTION


# %%
answer = checks.check_procrustes_gradient(procrustes_gradient)
procrustes_gradient_here = use(answer, checks.procrustes_gradient)
answer

# %% [markdown]
# The judge of every gradient is a finite difference: step to both sides, and divide. It needs no
# formula. For each of the nine entries it needs two rotations.


# %%
def central_differences(M, G, h):
    """The gradient (3, 3) of the sum of G * R(M), from steps of h to both sides."""
    steps = h * torch.eye(9).reshape(9, 3, 3)
    after, before = nearest_rotation_here(M + steps), nearest_rotation_here(M - steps)
    return (G * (after - before)).sum((1, 2)).reshape(3, 3) / (2 * h)


U, V = R[:2]
starts["flat matrix"] = U @ torch.diag(torch.tensor([2.0, 1, 0])) @ V.T
starts["near a jump"] = U @ torch.diag(torch.tensor([2.0, 1, -0.95])) @ V.T
h = torch.logspace(-11, 0, 45)
off = {
    name: [(central_differences(M, G, step) - procrustes_gradient_here(M, G)).norm() for step in h]
    for name, M in starts.items()
}
for name, errors in off.items():
    print(f"{name:13s} differences and gradient agree to {min(errors):.0e}")
assert max(min(errors) for errors in off.values()) < 1e-6

# %% [markdown]
# But which step? Large ones leave the straight line, small ones lose digits. So a finite difference
# is a judge, and no way to train. Near a jump of $R$, where $s_2 + s_3$ is small, steps
# must be smaller still.

# %%
figures.chart(
    off,
    x=h,
    log="xy",
    xlabel="step h",
    ylabel="differences minus gradient, norm",
    size=(6.4, 3.6),
    alt="Disagreement over the step: four curves with a valley near steps of 1e-6 to 1e-5",
)

# %% [markdown]
# And autograd, through `torch.linalg.svd`? At the identity all singular values are equal. At our
# rotation they are equal but for the last digits.

# %%
for name, start in (("identity", torch.eye(3)), ("rotation", R[0])):
    leaf = start.clone().requires_grad_()
    U, _, Vh = torch.linalg.svd(leaf)
    by_autograd = torch.autograd.grad(U @ Vh, leaf, G)[0]
    print(f"{name}, first row of the gradient:")
    print("  autograd:", by_autograd[0].numpy().round(3))
    print("  here:    ", procrustes_gradient_here(start, G)[0].numpy().round(3))
    differences = central_differences(start, G, 1e-5)
    assert torch.allclose(procrustes_gradient_here(start, G), differences, atol=1e-7)

# %% [markdown] tags=["solution"]
# **Discussion.** Only the diagonal of $s_i + s_j$ can be 0 while $s_2 + s_3$ is not, and $W_{ii}$
# is 0 by its numerator: a matrix that is antisymmetric has no diagonal.
#
# Why the same formula? With $Y = U^T G V D$ the left side is $\sum_{ij} Y_{ij} W_{ij}$. Swapping the names
# i and j in the part with $X_{ji}$ gives $\sum_{ij} X_{ij} (Y_{ij} - Y_{ji}) / (s_i + s_j)$: the
# gradient is the formula with $G$ in the place of $dM$. A derivative that is its own
# transpose is the second derivative of something: $R$ is the gradient of $s_1 + s_2 + s_3$.
#
# Autograd fails since it asks how $U$ and $V$ turn, each alone, and divides by $s_i^2 - s_j^2$.
# Where two values are equal, $U$ and $V$ are not even unique; their product is.

# %% [markdown]
# ## 3. Six numbers, in three lines
#
# Six numbers are two vectors $a$ and $b$. Gram-Schmidt makes them the first two columns of a
# rotation: $r_1$ has the direction of $a$; $r_2$ lies in the plane of $a$ and $b$, at a right angle
# to $r_1$, on the side where $b$ is; and $r_3 = r_1 \times r_2$.
#
# | in | shape | |
# |---|---|---|
# | `x` | (N, 6) | $a$, then $b$: never 0 and never parallel; of any length; N may be 0 |
# | **out** | (N, 3, 3) | rotations, with the columns $r_1, r_2, r_3$ |
#
# It is a network's last layer: the gradient has to pass, and the check looks at it, too. Three lines
# are enough.
#
# The picture shows what is expected, looking down on the plane of $a$ and $b$.

# %%
cases = [[1.6, 0.3, 0, 0.4, 1.5, 0], [1.3, -0.6, 0, 1.6, 0.5, 0], [0.5, 1.4, 0, 1.5, 0.2, 0]]
expected = checks.six_to_rotation(torch.tensor(cases))

# %%
figure = figures.Picture(figsize=(7.4, 2.9), layout="constrained")
figure.alt = "Three pairs of dashed vectors, and of solid ones of length 1 at right angles"
for axes, x, r in zip(figure.subplots(1, 3), cases, expected.numpy(), strict=True):
    vectors = {"a": x[:2], "b": x[3:5], "$r_1$": r[:2, 0], "$r_2$": r[:2, 1]}
    for number, (name, v) in enumerate(vectors.items()):
        look = {"color": COLOURS[number % 2], "linestyle": "--" if number < 2 else "-"}
        arrow = {"arrowstyle": "->", "shrinkA": 0, "shrinkB": 0, "linewidth": 2, **look}
        axes.annotate("", v, (0, 0), arrowprops=arrow)
        aside = -0.2 * r[:2, 1] if name == "$r_1$" else 0.16 * np.divide(v, np.hypot(*v))
        axes.text(*(v + aside), name, ha="center", va="center", fontsize=11)
    towards = r[2, 2] > 0
    axes.set_title(f"$r_3$ {'towards' if towards else 'away from'} you", fontsize=10)
    axes.set(xlim=(-0.5, 2), ylim=(-1.2, 1.8), aspect="equal", xlabel="x")
figure.axes[0].set_ylabel("y")
figure


# %%
def six_to_rotation(x):
    """The rotations (N, 3, 3) of six numbers each (N, 6), by Gram-Schmidt.

    >>> six_to_rotation(torch.tensor([[2.0, 0, 0, 5, 0, 3]]))
    tensor([[[ 1.,  0.,  0.],
             [ 0.,  0., -1.],
             [ 0.,  1.,  0.]]])
    """
    ### BEGIN SOLUTION
    r_1 = nn.functional.normalize(x[:, :3], dim=-1)
    r_2 = nn.functional.normalize(x[:, 3:] - (r_1 * x[:, 3:]).sum(-1, keepdim=True) * r_1, dim=-1)
    return torch.stack([r_1, r_2, torch.linalg.cross(r_1, r_2)], -1)
    ### END SOLUTION


# %%
answer = checks.check_six_to_rotation(six_to_rotation)
six_to_rotation_here = use(answer, checks.six_to_rotation)
answer

# %% [markdown]
# Now it is the last layer of a network. The task is that of the paper's Table IV: nine numbers of a
# rotation go in, the same rotation is to come out. The loss is the squared distance of the two
# matrices.


# %%
def train(size, loss):
    """A network from R (N, 3, 3) to `size` numbers, that makes `loss(numbers, R)` small."""
    torch.manual_seed(0)
    steps = choose(tiny=60, book=400, paper=8000)
    layers = [nn.Linear(9, 128), nn.LeakyReLU(), nn.Linear(128, 128), nn.LeakyReLU()]
    network = nn.Sequential(nn.Flatten(), *layers, nn.Linear(128, size)).float()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        R = rotations.random_rotations(256, generator=generator, dtype=torch.float32)
        optimiser.zero_grad()
        loss(network(R), R).backward()
        optimiser.step()
        schedule.step()
    return network.requires_grad_(False)


test = rotations.random_rotations(20000, generator=1)

# %%
layers = {"four numbers": (4, rotations.quaternion_to_matrix)}
layers["six numbers"] = (6, six_to_rotation_here)
worst = {}
for name, (size, layer) in layers.items():
    network = train(size, lambda x, R, layer=layer: (layer(x) - R).square().sum((1, 2)).mean())
    said = layer(network(test.float()).double())
    errors = torch.rad2deg(rotations.geodesic_distance(said, test))
    worst[name] = errors.max()
    print(f"{name:12s}  mean error {errors.mean():5.2f} degrees, worst {errors.max():6.2f}")
if scale() == "book":
    assert worst["six numbers"] < 20 and worst["four numbers"] > 150

# %% [markdown] tags=["solution"]
# **Discussion.** The two vectors are not equals: $a$ keeps its direction, and $b$ is bent. An error
# in $a$ goes into $r_1$ whole, and part of it into $r_2$; an error in $b$ never reaches $r_1$.
# Procrustes treats all numbers alike, and that is perhaps why it is ahead of six numbers in the
# paper's Table IV.
#
# Rows or columns is a matter of taste, PyTorch3D takes rows. But weights that were trained with one
# give the inverse rotation with the other.

# %% [markdown]
# ## 4. A representation with a hole
#
# A colleague's network says rotations with five numbers: the direction $d$ of the object's z axis
# (three), and how far the object is turned about it (the cosine and sine of an angle). The angle is
# counted from a zero mark, $a \times d$. The axis $a$ is fixed, somewhere in the code, and nobody
# wrote it down.
#
# The mean error looks fine, and nobody complained. But a zero mark for every direction cannot be
# had without a hole: for $d = \pm a$ there is none. Find $a$ from the errors on a test set alone.
#
# | in | shape | |
# |---|---|---|
# | `R` | (N, 3, 3) | true rotations of the test set; $d$ is their third column |
# | `errors` | (N,) | angle between the network's answer and the truth; radians |
# | **out** | (3,) | $a$, of length 1; $-a$ is just as right. To 8 degrees |
#
# Test sets are not clean. Up to 10 of 4000 labels may be wrong, and their errors are large too,
# whatever the network said.
#
# The picture shows what is expected for one test set: all directions $d$ on a map of the sphere, the
# worst errors dark, and rings around the axis that your function should give, on both sides.


# %%
def error_map(R, errors, axis=None):
    """The 4000 largest errors over the direction of the z axis; rings around an axis."""
    order = errors.argsort()[-4000:]
    x, y, z = R[order, :, 2].T
    figure = figures.Picture(figsize=(7, 3.6), layout="constrained")
    figure.alt = "Map of all directions; the large errors lie in two spots opposite to each other"
    axes = figure.add_subplot(projection="mollweide")
    look = {"s": 6, "lw": 0, "aa": False, "marker": "s", "cmap": "viridis_r", "clim": (0, 30)}
    dots = axes.scatter(torch.atan2(y, x), z.asin(), c=torch.rad2deg(errors[order]), **look)
    figure.colorbar(dots, label="error, degrees", shrink=0.7, extend="max")
    for end in () if axis is None else (axis, -axis):
        place = float(torch.atan2(end[1], end[0])), float(end[2].asin())
        axes.plot(*place, "o", markersize=24, fillstyle="none", color=COLOURS[1], mew=2.5)
    axes.grid(alpha=0.3)
    axes.set(xlabel="longitude of d, -180° to 180°", ylabel="latitude of d", xticklabels=[])
    return figure


# %%
inputs = list(checks.check_hole_axis.inputs(np.random.default_rng(3)))
_, some_R, some_errors = inputs[-1]
error_map(some_R, some_errors, checks.hole_axis(some_R, some_errors))


# %%
def hole_axis(R, errors):
    """The axis (3,) of the directions for which the representation has a hole.

    >>> R = torch.stack([torch.eye(3), torch.diag(torch.tensor([1.0, -1, -1]))])
    >>> hole_axis(R, torch.tensor([3.0, 2.0])).abs()
    tensor([0., 0., 1.])
    """
    ### BEGIN SOLUTION
    worst = errors >= torch.quantile(errors, 0.98)
    d = R[worst, :, 2]
    return torch.linalg.eigh(d.T @ d).eigenvectors[:, -1]  # of the largest eigenvalue
    ### END SOLUTION


# %%
answer = checks.check_hole_axis(hole_axis)
hole_axis_here = use(answer, checks.hole_axis)
answer

# %% [markdown]
# Those errors were made by hand. Here is a real network that was trained with such five numbers.
# Its axis is known to nobody but a seed:

# %%
secret = rotations.random_rotations(generator=77)[:, 0]


def five_numbers_loss(numbers, R):
    """Squared distance to the five numbers of the truth."""
    return (numbers - checks.to_five(R, secret.float())).square().sum(-1).mean()


network = train(5, five_numbers_loss)
said = checks.from_five(network(test.float()).double(), secret)
errors = rotations.geodesic_distance(said, test)
found = hole_axis_here(test, errors).double()
off = torch.rad2deg((found @ secret).abs().clamp(max=1).acos())
wrong = torch.rad2deg(errors)
print(f"median error {wrong.median():.1f} degrees, mean {wrong.mean():.1f}", end="")
print(f", worst {wrong.max():.0f}; the axis is {off:.1f} degrees off")
if scale() == "book":
    assert off < 8 and wrong.max() > 40 > 10 * wrong.mean()
error_map(test, errors, found)

# %% [markdown]
# How much a hole hurts is a matter of how one looks. The mean hides it:

# %%
away = (test[:, :, 2] @ secret).abs() < np.cos(np.deg2rad(25))
for name, some in (("near the hole", ~away), ("elsewhere", away)):
    share = some.double().mean()
    print(f"{name:13s} {share:4.0%} of all, mean error {wrong[some].mean():5.1f} degrees", end="")
    print(f", worst {wrong[some].max():5.1f}")

# %% [markdown] tags=["solution"]
# **Discussion.** The heaps at $a$ and $-a$ cancel in a plain mean, so one needs a quantity that does
# not know the sign: $d\,d^T$. The single worst error is no witness: it is often a wrong label. No
# other choice of the zero mark would help. A zero mark for every direction would be a field of
# tangents on the sphere without a gap, and the hairy ball theorem says that there is none. The
# numbers as such are not at fault: a matrix contains the same $d$, and has no hole.
#
# So look at the worst errors first, and ask what they have in common. The chapter's torn
# representations show themselves in the same way.

# %% [markdown]
# ## 5. Open: the mean of several predictions
#
# Five networks look at the same object, or one network at five crops. Each says a rotation, in
# numbers of some representation. What is their mean? The obvious thing is to average the numbers. Is
# that right?
#
# | in | shape | |
# |---|---|---|
# | `numbers` | (N, size) | N predictions, as networks say them |
# | `representation` | a text | "quaternion", "axis_angle", "euler", "6d" or "procrustes" |
# | **out** | (3, 3) | one rotation |
#
# - `RotationHead(representation)` of chapter 5 knows them all: `.decode(numbers)` gives rotations
#   (N, 3, 3), `.encode(R)` numbers (N, size), `.size` how many.
# - All predictions count the same, whatever the length of their numbers. Networks say quaternions of
#   both signs, quaternions and vectors of any length, and matrices that stretch.
#
# There are many means, and the check takes any good one: the root mean square angle to the
# predictions may be at most 5 % above the least that any rotation has.
#
# The picture shows what is expected: to stay in the grey, wherever the predictions are. The lines
# average the numbers and decode the mean. Eight predictions lie about 20 degrees around a true
# rotation, which turns from 0 to 180 degrees about a slanted axis.

# %%
slanted = nn.functional.normalize(torch.tensor([0.96, 0.15, 0.25]), dim=0)
degrees = torch.arange(0, 181, 4.0)
centres = rotations.axis_angle_to_matrix(torch.deg2rad(degrees)[:, None] * slanted)
eight = torch.randn(8, 3, generator=torch.Generator().manual_seed(4))
turns = torch.deg2rad(torch.tensor(20.0)) / 3**0.5 * eight
near = centres[:, None] @ rotations.axis_angle_to_matrix(turns)  # (46, 8, 3, 3)


def spreads(mean):
    """For each representation, the root mean square angles of its means; degrees."""
    found = {}
    for name in checks.REPRESENTATIONS:
        numbers = RotationHead(name).encode(near)
        means = torch.stack([mean(some, name).double() for some in numbers])
        angles = rotations.geodesic_distance(means[:, None], near)  # (46, 8)
        found[name] = torch.rad2deg(angles.square().mean(1).sqrt())
    return found


# %%
def draw_spreads(found, alt):
    """The spreads over the angle of the true rotation, and the band that is asked for."""
    best = torch.rad2deg(torch.stack([checks.least_spread(R) for R in near]))
    dashes = (*STYLES, (0, (5, 1, 1, 1, 1, 1)))
    looks = {name: {"ls": style} for name, style in zip(found, dashes, strict=False)}
    return figures.chart(
        found,
        x=degrees,
        bands={"expected": (best, 1.05 * best)},
        looks=looks | {"expected": {"color": "0.6", "alpha": 1}},
        log="y",
        xlabel="angle of the true rotation, degrees",
        ylabel="r.m.s. angle to the predictions, degrees",
        xticks=range(0, 181, 30),
        yticks=[15, 20, 30, 50, 100, 180],
        ylim=(12, 200),
        legend={"loc": "upper left", "framealpha": 1},
        size=(7.4, 3.8),
        alt=alt,
    )


# %%
def mean_of_numbers(numbers, representation):
    """The obvious thing: average, then decode."""
    return RotationHead(representation).decode(numbers.mean(0))


alt = "Means of numbers: 6d and procrustes stay in the grey, the other three leave it"
of_numbers = spreads(mean_of_numbers)
assert of_numbers["procrustes"].max() < 21 and of_numbers["axis_angle"].max() > 90
draw_spreads(of_numbers, alt)


# %%
def mean_prediction(numbers, representation):
    """A mean rotation (3, 3) of N predictions (N, size).

    >>> mean_prediction(torch.tensor([[1.0, 0, 0, 0], [-2.0, 0, 0, 0]]), "quaternion").diagonal()
    tensor([1., 1., 1.])
    """
    ### BEGIN SOLUTION
    R = RotationHead(representation).decode(numbers)
    return nearest_rotation_here(R.mean(0, keepdim=True))[0]
    ### END SOLUTION


# %%
answer = checks.check_mean_prediction(mean_prediction)
mean_prediction_here = use(answer, mean_of_numbers)
answer

# %% [markdown]
# The same picture with the mean here. Until yours is done it is that of the numbers again, so that
# nothing is given away.

# %%
found = spreads(mean_prediction_here)
for name, values in found.items():
    print(f"{name:10s} worst {values.max():6.2f} degrees")
draw_spreads(found, "Root mean square angles of the means here, over the angle of the rotation")

# %% [markdown] tags=["solution"]
# With the solution all five are one mean, and it is that of the library:

# %% tags=["solution"]
for values in found.values():
    assert torch.allclose(values, found["procrustes"])
mean = mean_prediction_here(RotationHead("euler").encode(near[30]), "euler")
assert torch.allclose(mean, rotations.mean_rotation(near[30]))

# %% [markdown] tags=["solution"]
# **Discussion.** Numbers may be averaged where near rotations have near numbers, and where far
# numbers are not the same rotation: that is what the chapter calls continuous. 6D and Procrustes
# pass, but their lengths act as weights. A network whose outputs grow shorter when it is unsure may
# even gain from that.
#
# The mean of matrices, brought back by Procrustes, minimises the sum of squared *chords*. It is the
# same as the first eigenvector of $\sum q\,q^T$ for unit quaternions, which knows no sign. To
# minimise the sum of squared *angles*, go on from there: average the axis-angles of
# $\bar R^T R_i$, turn $\bar R$ by that, repeat. For predictions near to each other the two are
# nearly one. And with predictions spread all over there is no mean worth the name: $s_2 + s_3$ of
# the mean matrix is then near 0.
