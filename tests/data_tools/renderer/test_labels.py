import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.renderer import (
    Light,
    material_images,
    prepare,
    render_colour,
    render_labels,
)
from data_tools.shapes import Material

K = np.array([[40.0, 0, 19.5], [0, 40.0, 14.5], [0, 0, 1]])
EYE = np.eye(3)


def at(x, y, z):
    return EYE, np.array([x, y, z], float)


def box_of(mask):
    y, x = np.nonzero(mask)
    if not len(x):
        return [0, 0, 0, 0]
    return [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]


def embree(objects, poses, camera, size, near):
    """Depth (infinite for none) of every object at every pixel by Embree, in float32."""
    scenes = pytest.importorskip("embreex.rtcore_scene", reason="embreex is not installed")
    construction = pytest.importorskip("embreex.mesh_construction")
    width, height = size
    y, x = np.mgrid[:height, :width].reshape(2, -1)
    rays = np.stack([x, y, np.ones(x.size)], 1) @ np.linalg.inv(camera).T
    depth = np.full((len(objects), x.size), np.inf)
    for k, (item, (R, t)) in enumerate(zip(objects, poses, strict=True)):
        scene = scenes.EmbreeScene()
        mesh = item.mesh
        construction.TriangleMesh(scene, mesh.vertices.astype(np.float32)[mesh.faces])
        # Rays begin at the near plane, in the object's frame, where float32 is finest.
        begin = ((near * rays - t) @ R).astype(np.float32)
        hit = scene.run(begin, (rays @ R).astype(np.float32), query="INTERSECT", output=1)
        depth[k] = np.where(hit["primID"] >= 0, hit["tfar"].astype(np.float64) + near, np.inf)
    return depth.reshape(-1, height, width)


@pytest.mark.slow
def test_agrees_with_embree(make_scene):
    wrong = pixels = cut = 0
    errors = []
    for seed in range(16):
        objects, poses, camera, size = make_scene(seed, size=(320, 188))
        labels = render_labels(objects, poses, camera, size)
        depth = embree(objects, poses, camera, size, 0.01)
        nearest = depth.min(0)
        instance = np.where(np.isfinite(nearest), depth.argmin(0), -1)
        wrong += np.count_nonzero(instance != labels.instance)
        pixels += instance.size
        both = (instance >= 0) & (instance == labels.instance)
        errors.append(np.abs(labels.depth - nearest)[both])
        assert np.count_nonzero(labels.full_masks != np.isfinite(depth)) <= 1e-4 * depth.size
        cut += sum(d.min() < 0.0101 for d in depth)
    assert cut >= 5  # objects on the near plane are among them
    assert wrong < 1e-4 * pixels
    assert np.percentile(np.concatenate(errors), 99) < 1e-5  # 0.01 mm


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_masks_boxes_and_fractions(make_scene, cast_rays, seed):
    objects, poses, camera, size = make_scene(seed, size=(24, 18), count=3)
    labels = render_labels(objects, poses, camera, size)
    wide, high = size
    y, x = (c.ravel() for c in np.mgrid[-high : 2 * high, -wide : 2 * wide])
    depth = np.stack(
        [
            cast_rays(item, R, t, camera, x, y)[0].reshape(3 * high, 3 * wide)
            for item, (R, t) in zip(objects, poses, strict=True)
        ]
    )
    full = np.isfinite(depth)
    inside = np.s_[:, high : 2 * high, wide : 2 * wide]
    nearest = depth[inside].min(0)
    visible = full[inside] & (depth[inside] == nearest)
    np.testing.assert_array_equal(labels.full_masks, full[inside])
    np.testing.assert_array_equal(labels.visible_masks, visible)
    np.testing.assert_array_equal(labels.visible_pixels, visible.sum((1, 2)))
    np.testing.assert_array_equal(labels.full_pixels, full.sum((1, 2)))
    share = visible.sum((1, 2)) / np.maximum(full.sum((1, 2)), 1)
    np.testing.assert_allclose(labels.visible_fraction, share)
    shift = [wide, high, 0, 0]
    for k in range(3):
        assert labels.visible_boxes[k].tolist() == box_of(visible[k])
        expected = box_of(full[k])
        if full[k].any():
            expected = (np.array(expected) - shift).tolist()
        assert labels.full_boxes[k].tolist() == expected
    np.testing.assert_allclose(labels.depth, np.where(np.isfinite(nearest), nearest, 0), rtol=1e-6)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_coordinates_land_on_their_pixel(make_scene, seed):
    objects, poses, camera, size = make_scene(seed, size=(160, 94))
    labels = render_labels(objects, poses, camera, size)
    for k, (R, t) in enumerate(poses):
        y, x = np.nonzero(labels.instance == k)
        points = labels.coordinates[y, x].astype(np.float64) @ R.T + t
        pixels = points @ camera.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        # float32 has 1e-7 of the distance to the object's centre; the nearest surfaces are 1 cm
        # away, where that is 1e-3 pixels.
        np.testing.assert_allclose(pixels, np.stack([x, y], 1), atol=0.01)
        np.testing.assert_allclose(points[:, 2], labels.depth[y, x], atol=1e-6)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_normals_and_faces(make_scene, cast_rays, seed):
    objects, poses, camera, size = make_scene(seed, size=(40, 30), count=3)
    labels = render_labels(objects, poses, camera, size)
    nothing = labels.instance < 0
    assert (labels.face[nothing] == -1).all()
    assert not labels.normals[nothing].any() and not labels.coordinates[nothing].any()
    for k, (item, (R, t)) in enumerate(zip(objects, poses, strict=True)):
        y, x = np.nonzero(labels.instance == k)
        mesh = item.mesh
        corners = mesh.vertices[mesh.faces[labels.face[y, x]]]
        edges = corners[:, 1:] - corners[:, :1]
        points = labels.coordinates[y, x].astype(np.float64) - corners[:, 0]
        weights = np.einsum("pij,pj->pi", np.linalg.pinv(edges.swapaxes(1, 2)), points)
        weights = np.column_stack([1 - weights.sum(1), weights])
        assert ((weights > -1e-3) & (weights < 1 + 1e-3)).all()
        expected = np.einsum("pk,pkj->pj", weights, mesh.corner_normals[labels.face[y, x]]) @ R.T
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        flat = np.cross(edges[:, 0], edges[:, 1]) @ R.T
        behind = (flat * (corners[:, 0] @ R.T + t)).sum(1) > 0
        expected[behind] *= -1
        # A point is known to 1e-7 m, a face is 1 mm high at least: 1e-4 of the normals' change.
        np.testing.assert_allclose(labels.normals[y, x], expected, atol=2e-3)


def test_faces_are_counted_in_the_mesh(make_triangles):
    line, wall = ((0, 0, 1), (1, 0, 1), (2, 0, 1)), ((-9, -9, 1), (0, 9, 1), (9, -9, 1))
    labels = render_labels([make_triangles(line, wall)], [at(0, 0, 0)], K, (40, 30))
    assert (labels.face == 1).all()


def test_types_and_shapes(shapes):
    labels = render_labels(shapes[:2], [at(0, 0, 0.3), at(0.02, 0, 0.4)], K, (40, 30))
    for name, shape, kind in (
        ("depth", (30, 40), np.float32),
        ("instance", (30, 40), np.int16),
        ("face", (30, 40), np.int32),
        ("coordinates", (30, 40, 3), np.float32),
        ("normals", (30, 40, 3), np.float32),
        ("full_masks", (2, 30, 40), bool),
        ("visible_masks", (2, 30, 40), bool),
        ("visible_pixels", (2,), np.int64),
        ("full_pixels", (2,), np.int64),
        ("visible_fraction", (2,), np.float64),
        ("visible_boxes", (2, 4), np.int64),
        ("full_boxes", (2, 4), np.int64),
    ):
        array = getattr(labels, name)
        assert array.shape == shape and array.dtype == kind, name


def test_an_empty_scene():
    labels = render_labels([], [], K, (40, 30))
    assert not labels.depth.any() and (labels.instance == -1).all() and (labels.face == -1).all()
    assert labels.full_masks.shape == labels.visible_masks.shape == (0, 30, 40)
    assert labels.visible_fraction.shape == (0,) and labels.full_boxes.shape == (0, 4)


def test_one_seen_one_hidden_one_behind_one_beside(shapes):
    ball = shapes[0]
    poses = [at(0, 0, 0.3), at(0, 0, 0.6), at(0, 0, -1), at(0.4, 0, 0.5)]
    labels = render_labels([ball] * 4, poses, K, (40, 30))
    assert (labels.visible_pixels > 0).tolist() == [True, False, False, False]
    assert (labels.full_pixels > 0).tolist() == [True, True, False, True]
    assert labels.visible_fraction.tolist() == [1, 0, 0, 0]
    assert labels.full_boxes[2].tolist() == [0, 0, 0, 0]
    assert labels.full_boxes[3][0] >= 40 and not labels.full_masks[3].any()
    assert labels.full_masks[1].any() and not labels.visible_masks[1].any()


def test_the_near_plane_opens_what_it_cuts(shapes):
    labels = render_labels([shapes[0]], [at(0, 0, 0.03)], K, (40, 30))
    # Inside a ball of 5 cm at its front third: every pixel sees the far wall, from inside.
    assert (labels.instance == 0).all()
    assert 0.05 < labels.depth.min() and labels.depth.max() < 0.0801
    assert (labels.normals[..., 2] < 0).all()


def test_same_bytes_whatever_the_number_of_threads(make_scene):
    threadpoolctl = pytest.importorskip("threadpoolctl", reason="threadpoolctl is not installed")
    scene = make_scene(5, size=(320, 188))
    results = []
    for threads in (1, 2, 3):
        with threadpoolctl.threadpool_limits(threads):
            labels = render_labels(*scene)
            picture = render_colour(*scene, [Light((0.3, -0.5, 0))])
        results.append([array.tobytes() for array in (*vars(labels).values(), picture)])
    assert results[0] == results[1] == results[2]


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_materials_of_what_is_seen(shapes, seed):
    materials = (Material((1, 1, 1), infrared=0.2, specular=0.9), Material((1, 1, 1), infrared=0.7))
    mesh = shapes[2].mesh
    kinds = np.random.default_rng(seed).permutation(np.arange(len(mesh.faces)) % 2)
    kinds = kinds.astype(np.int16)
    box = prepare(dataclasses.replace(mesh, material=kinds, materials=materials))
    objects = [box, shapes[0]]
    labels = render_labels(objects, [at(0, 0, 0.3), at(0.05, 0, 0.5)], K, (40, 30))
    infrared, specular = material_images(objects, labels)
    for y, x in np.ndindex(30, 40):
        index = labels.instance[y, x]
        expected = (0, 0) if index < 0 else (0.5, 0)
        if index == 0:
            made_of = materials[kinds[labels.face[y, x]]]
            expected = made_of.infrared, made_of.specular
        assert (infrared[y, x], specular[y, x]) == pytest.approx(expected)
    assert len(np.unique(infrared)) >= 3
    with pytest.raises(ValueError, match="^objects: expected the 2 of the labels"):
        material_images([box], labels)
