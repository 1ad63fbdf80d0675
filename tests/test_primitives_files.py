"""Files of a primitive: the names of its arrays, what its card says, and what is refused."""

import hashlib
import json
import math
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bodies import l_parts
from safetensors.numpy import load_file, save_file
from toy_wedge import wedge_primitive

from gfp_grasp.errors import AssetMissing, UnreadableFile
from gfp_grasp.primitives import read_primitive, save_primitive
from gfp_grasp.primitives.store import read_spec
from gfp_grasp.types import GenericPrimitive, PartBinding, Symmetry, Variant

NAMES = {
    *("vertices", "faces", "modes", "explained", "log_scale_cov", "coefficient_samples", "up", "regions", "symmetry"),
    *("part_sizes", "part_vertices", "part_faces", "part_merges", "part_errors_m"),
}
BINDING = {f"binding_{name}" for name in ("corners", "weights", "height_m", "ends", "gap_m")}


def _primitive() -> GenericPrimitive:
    """A wedge with an ear and a tail that may be missing together, and with parts and prototypes."""
    wedge = wedge_primitive()
    regions = np.where(wedge.vertices[:, 0] > 0.06, 2, np.where(wedge.vertices[:, 0] < -0.03, 3, 0)).astype(np.uint8)
    weights = np.array([[1, 0, 0], [0.5, 0.25, 0.25]])
    binding = PartBinding(
        np.array([[0, 1, 2], [3, 2, 1]]), weights, np.array([1e-3, 0]), np.array([1, 2]), np.array([0.01, 0, 0.02])
    )
    own = replace(
        wedge,
        subcategory="odd",
        spec=None,
        regions=regions,
        region_names=("outside", "inside", "ear", "tail"),
        licence="MIT",
        parts=l_parts(),
        part_merges=np.array([[0, 1]]),
        part_errors_m=np.array([[0.2, 0.3], [0.0, 0.1]]),
        binding=binding,
        prototypes=np.eye(3)[:2],
        card={"seed": 3, "category": "another", "sha256": "none", "subcategory": "x", "figures": [1.5]},
    )
    bare = replace(own, symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), 3, np.array([0.0, 1.0, 0.0])), card={})
    bare = replace(bare, prototypes=np.zeros((0, 0)), binding=None)
    return replace(own, variants=(Variant(("ear", "tail"), bare, np.arange(len(wedge.vertices))),))


def test_a_primitive_is_three_files_that_others_may_read(tmp_path: Path) -> None:
    primitive = _primitive()
    path = save_primitive(primitive, tmp_path / "new" / "gps")
    assert path == tmp_path / "new" / "gps" / "wedge.odd.safetensors"
    assert {file.name for file in path.parent.iterdir()} == {f"wedge.odd.{e}" for e in ("safetensors", "ply", "json")}
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    mesh = trimesh.load_mesh(path.with_suffix(".ply"))
    np.testing.assert_allclose(np.sort(mesh.vertices, axis=0), np.sort(primitive.vertices, axis=0), atol=1e-7)
    inner = {f"without.ear+tail.{name}" for name in (*NAMES, "vertex_map")}
    arrays = load_file(path)
    assert set(arrays) == NAMES | BINDING | {"prototypes"} | inner
    assert arrays["modes"].dtype == np.float32
    np.testing.assert_array_equal(arrays["symmetry"], [0, 0, 1, 1, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(arrays["without.ear+tail.symmetry"], [0, 0, 1, 3, 0, 1, 0])


def test_the_card_names_digests_and_does_not_let_itself_be_overwritten(tmp_path: Path) -> None:
    primitive = _primitive()
    path = save_primitive(primitive, tmp_path)
    text = path.with_suffix(".json").read_text(encoding="utf-8")
    card = json.loads(text)
    assert text.endswith("}\n")
    shape = b"".join(
        np.ascontiguousarray(array).tobytes()
        for array in (primitive.vertices, primitive.faces, primitive.modes.astype(np.float32))
    )
    assert card == {
        "category": "wedge",
        "subcategory": "odd",
        "licence": "MIT",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "shape_sha256": hashlib.sha256(shape).hexdigest(),
        "region_names": ["outside", "inside", "ear", "tail"],
        "spec": json.loads(json.dumps(primitive.spec.as_dict())),
        "seed": 3,
        "figures": [1.5],
    }
    plain = save_primitive(
        replace(primitive, subcategory="", spec=None, card={"subcategory": "x"}, variants=()), tmp_path
    )
    assert plain.name == "wedge.safetensors"
    assert "subcategory" not in json.loads(plain.with_suffix(".json").read_text(encoding="utf-8"))
    # Parts are no shape: a network does not mind other ones.
    other = save_primitive(
        replace(primitive, parts=(), part_merges=np.zeros((0, 2)), part_errors_m=np.zeros((0, 2)), binding=None),
        tmp_path,
    )
    again = json.loads(other.with_suffix(".json").read_text(encoding="utf-8"))
    assert again["shape_sha256"] == card["shape_sha256"]
    assert again["sha256"] != card["sha256"]


def test_all_of_a_primitive_comes_back(tmp_path: Path) -> None:
    primitive = _primitive()
    again = read_primitive(save_primitive(primitive, tmp_path))
    for one, other in ((again, primitive), (again.variants[0].primitive, primitive.variants[0].primitive)):
        for name in ("vertices", "faces", "explained", "log_scale_cov", "coefficient_samples", "up", "regions"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        for name in ("part_merges", "part_errors_m", "prototypes"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        np.testing.assert_allclose(one.modes, other.modes, atol=1e-8)
        assert (one.name, one.licence, one.region_names, one.spec) == (
            other.name,
            "MIT",
            other.region_names,
            other.spec,
        )
        assert one.symmetry.order == other.symmetry.order
        assert len(one.parts) == len(other.parts)
        np.testing.assert_array_equal(one.parts[0].vertices, other.parts[0].vertices)
        assert (one.symmetry.mirror_normal is None) == (other.symmetry.mirror_normal is None)
    assert again.binding is not None
    for name in ("corners", "weights", "height_m", "ends", "gap_m"):
        np.testing.assert_array_equal(getattr(again.binding, name), getattr(primitive.binding, name), err_msg=name)
    assert again.variants[0].primitive.binding is None
    assert again.variants[0].primitive.variants == ()
    assert again.card["seed"] == 3
    round_one = replace(primitive, symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), math.inf), variants=())
    assert read_primitive(save_primitive(round_one, tmp_path)).symmetry.order == math.inf


def _change_card(path: Path, **changes: object) -> None:
    card = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    card = {key: value for key, value in {**card, **changes}.items() if value is not None}
    path.with_suffix(".json").write_text(json.dumps(card), encoding="utf-8")


def test_a_file_of_an_older_version_is_read_where_what_it_lacks_may_be_lacking(tmp_path: Path) -> None:
    path = save_primitive(replace(_primitive(), variants=()), tmp_path)
    left_out = ("part_merges", "part_errors_m", "prototypes")
    save_file({name: array for name, array in load_file(path).items() if name not in left_out}, path)
    _change_card(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest(), spec=None)
    again = read_primitive(path)
    assert (again.part_merges.shape, again.part_errors_m.shape, len(again.prototypes)) == ((0, 2), (0, 2), 0)
    assert read_spec(path) == again.spec
    save_file({name: array for name, array in load_file(path).items() if name != "modes"}, path)
    _change_card(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(UnreadableFile, match="lacks 'modes'"):
        read_primitive(path)


def test_a_spec_is_read_from_the_card_alone(tmp_path: Path) -> None:
    primitive = _primitive()
    path = save_primitive(primitive, tmp_path)
    path.write_bytes(b"torn")
    assert read_spec(path) == primitive.spec
    _change_card(path, spec={**primitive.spec.as_dict(), "rests": {"afloat": 1.0}})
    with pytest.raises(UnreadableFile, match=r"wedge\.odd\.json"):
        read_spec(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[1]", "holds a list"),
        (b"{", "is not a card"),
        (b"\xff\xfe", "is not a card"),
        (b'{"category": "wedge"}', "card of 'wedge'"),
        (b'{"category": "wedge", "subcategory": "even"}', "card of 'wedge.even'"),
        (b"{}", "card of ''"),
    ],
)
def test_a_card_that_is_none_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = save_primitive(_primitive(), tmp_path)
    path.with_suffix(".json").write_bytes(content)
    with pytest.raises(UnreadableFile, match=said):
        read_primitive(path)
    path.with_suffix(".json").unlink()
    with pytest.raises(AssetMissing, match="json is missing"):
        read_spec(path)


def test_a_file_of_other_content_than_its_card_says_is_refused(tmp_path: Path) -> None:
    path = save_primitive(_primitive(), tmp_path)
    arrays = load_file(path)
    save_file({**arrays, "up": np.array([0.0, 0.0, 2.0])}, path)
    with pytest.raises(UnreadableFile, match="has sha256"):
        read_primitive(path)
    save_file({**arrays, "vertices": arrays["vertices"][:-1]}, path)
    _change_card(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(UnreadableFile, match="malformed"):
        read_primitive(path)
