import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from data_tools.bop import ModelInfoWarning
from data_tools.linemod import LinemodModels
from data_tools.linemod.folders import find_objects


def models_of(made) -> LinemodModels:
    return LinemodModels(find_objects(made.path))


def test_meshes_are_in_metres(pvnet, own, densefusion):
    for made, ids in ((pvnet, (6, 10)), (own, (1,)), (densefusion, (1, 2))):
        models = models_of(made)
        assert models.ids == ids
        assert repr(models) == f"LinemodModels(objects {list(ids)})"
        for object_id in ids:
            mesh = models.mesh(object_id)
            sides = {1: (90, 60, 40), 2: (60, 80, 20), 6: (50, 70, 30), 10: (40, 30, 20)}[object_id]
            np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), np.divide(sides, 1000))
            assert models.mesh(object_id) is mesh
            assert len(mesh.faces) == 12


def test_infos_of_the_mesh(pvnet):
    models = models_of(pvnet)
    for object_id in models.ids:
        info, points = models.info(object_id), models.mesh(object_id).vertices
        np.testing.assert_array_equal(info.minimum, points.min(0))
        np.testing.assert_array_equal(info.size, np.ptp(points, axis=0))
        assert info.diameter == pytest.approx(pdist(points).max(), abs=1e-15)
        assert models.info(object_id) is info


@pytest.mark.parametrize("suffix", [".obj", ".stl"])
def test_models_of_other_formats(own, densefusion, suffix):
    for made, name, object_id, unit in (
        (own, "model", 1, 1),
        (densefusion, "models/obj_02", 2, 0.001),
    ):
        mesh = models_of(made).mesh(object_id)
        scaled = mesh.copy().apply_scale(1 / unit)
        made.remove(f"{name}.ply")
        data = scaled.export(file_type=suffix[1:])
        made.write(name + suffix, data)
        again = models_of(made).mesh(object_id)
        assert len(again.vertices) == len(mesh.vertices) and len(again.faces) == len(mesh.faces)
        np.testing.assert_allclose(again.bounds, mesh.bounds, atol=1e-8)


def test_infos_of_the_list(densefusion):
    info = models_of(densefusion).info(1)
    assert info.diameter == 0.1155
    np.testing.assert_array_equal(info.minimum, [-0.045, -0.03, -0.02])
    np.testing.assert_array_equal(info.size, [0.09, 0.06, 0.04])
    densefusion.edit("models/models_info.yml", "2: {", "5: {")
    with pytest.warns(ModelInfoWarning, match=r"object 2 in models_info\.yml: its diameter is mea"):
        measured = models_of(densefusion).info(2)
    assert measured.diameter == pytest.approx(np.hypot(0.1, 0.02), rel=1e-7)
    # Beside the folder of models instead of in it.
    (densefusion.path / "models/models_info.yml").rename(densefusion.path / "models_info.yml")
    assert models_of(densefusion).info(1).diameter == 0.1155


def test_the_diameter_of_an_own_object(own):
    assert models_of(own).info(1).diameter == 0.12
    own.remove("diameter.txt")
    sides = [0.09, 0.06, 0.04]
    assert models_of(own).info(1).diameter == pytest.approx(np.linalg.norm(sides), rel=1e-7)


def test_two_objects_look_the_same_from_two_sides(pvnet):
    """The half turn is about the middle of the box, which lies beside the origin here."""
    models = models_of(pvnet)
    np.testing.assert_array_equal(models.info(6).symmetries(), np.eye(4)[None])
    identity, turn = models.info(10).symmetries()
    points = models.mesh(10).vertices
    turned = points @ turn[:3, :3].T + turn[:3, 3]
    assert np.abs(turned - points).max() > 0.01
    assert np.abs(turned[:, None] - points).max(-1).min(1).max() < 1e-9
    np.testing.assert_allclose(turn @ turn, identity, atol=1e-15)


def test_an_own_object_is_not_the_eggbox(own):
    assert len(models_of(own).info(1).symmetries()) == 1


def test_keypoints(pvnet, own, densefusion):
    np.testing.assert_array_equal(
        models_of(pvnet).keypoints(6), [[0.01, 0.02, 0.03], [-0.01, 0, 0.025]]
    )
    own.write("fps.txt", "1 2 3\n")
    np.testing.assert_array_equal(models_of(own).keypoints(1), [[1, 2, 3]])
    with pytest.raises(ValueError, match=r"01/farthest\.txt: no such file"):
        models_of(densefusion).keypoints(1)
    pvnet.write("cat/farthest.txt", "1 2\n")
    with pytest.raises(ValueError, match=r"farthest\.txt: expected numbers"):
        models_of(pvnet).keypoints(6)


def test_objects_without_a_model(pvnet):
    pvnet.remove("cat/cat.ply")
    assert models_of(pvnet).ids == (10,)
    pvnet.remove("eggbox/eggbox.ply")
    assert models_of(pvnet).ids == ()


@given(st.integers(-3, 20).filter(lambda i: i not in (6, 10)))
def test_other_objects_are_refused(all_layouts, object_id):
    models = models_of(all_layouts[0])
    for call in (models.mesh, models.info, models.keypoints):
        with pytest.raises(ValueError, match=f"object_id: expected one of 6, 10, got {object_id}"):
            call(object_id)
