"""The peers' networks, and their completions of the front of a cylinder."""

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from safetensors.torch import save_file
from test_peers_cube import EYE, front_of_cylinder

from gfp_grasp import completers
from gfp_grasp.bench import CompletionConfig, bench_completion
from gfp_grasp.bench.methods import run_method, view_object
from gfp_grasp.completers import PEER_COMPLETERS, InTrueBox, ToldTruth, get_completer, needs_class
from gfp_grasp.errors import InvalidOption, NotTrained, TooFewPoints, UnreadableFile
from gfp_grasp.peers import (
    NUM_INPUT,
    PEERS,
    PointNetwork,
    check_trained,
    complete_by_peer,
    get_peer,
    make_network,
    network_class,
    read_network,
    true_box,
    weights_stem,
)
from gfp_grasp.peers import weights as stored
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import (
    UNKNOWN,
    CollisionMesh,
    CompletedShape,
    Detection,
    OrientedBox,
    PointCloud,
    SupportPlane,
    TrueObject,
)

UP = np.array([0.0, 0.0, 1.0])
POINT_PEERS = [name for name in PEERS if issubclass(network_class(name), PointNetwork)]
GRID_PEERS = [name for name in PEERS if name not in POINT_PEERS]
MOST_BYTES = 2_500_000
MOST_BYTES_OF_ALL = 24_000_000


def fresh(name: str):
    """The network of a peer with the same random weights each time."""
    torch.manual_seed(0)
    return make_network(name).eval()


def set_bias(network: torch.nn.Module, value: float) -> None:
    """Set what the last layer of a grid network adds."""
    last = [module for module in network.modules() if isinstance(module, torch.nn.Conv3d | torch.nn.ConvTranspose3d)]
    assert last[-1].bias is not None
    torch.nn.init.constant_(last[-1].bias, value)


def detection_of(cloud: PointCloud) -> Detection:
    box = OrientedBox(np.eye(4), np.ptp(cloud.points, axis=0))
    return Detection(cloud, UP, SupportPlane(UP, 0.0), "", {}, box)


def cylinder() -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(0.04, 0.12, sections=64)
    mesh.apply_translation((0, 0, 0.06))
    return mesh


def num_bytes(name: str) -> int:
    """Bytes of the weights as half floats."""
    return 2 * sum(tensor.numel() for tensor in make_network(name).state_dict().values())


def test_there_are_six_peers_each_with_its_source() -> None:
    assert list(PEERS) == ["pcn", "foldingnet", "topnet", "3d-epn", "3d-sc", "scrg"]
    for name in PEERS:
        head = sys.modules[network_class(name).__module__].__doc__ or ""
        assert "Source: " in head
        assert "arXiv" in head or "CVPR" in head
    assert POINT_PEERS == ["pcn", "foldingnet", "topnet"]


@pytest.mark.parametrize(("name", "counts"), [("pcn", [256, 2304]), ("foldingnet", [2025]), ("topnet", [2048])])
def test_point_networks_answer_with_so_many_points_whatever_the_order_of_what_was_seen(
    name: str, counts: list[int]
) -> None:
    network, points = fresh(name), torch.rand(2, NUM_INPUT, 3) - 0.5
    with torch.inference_mode():
        answer, shuffled = network(points), network(points[:, torch.randperm(NUM_INPUT)])
        repeated = network(torch.cat([points, points[:, :100]], dim=1))
    assert [part.shape for part in answer] == [(2, count, 3) for count in counts]
    for part, others in zip(answer, zip(shuffled, repeated, strict=True), strict=True):
        for other in others:
            torch.testing.assert_close(part, other, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(("name", "num_in", "resolution"), [("3d-epn", 2, 32), ("3d-sc", 2, 32), ("scrg", 1, 40)])
def test_grid_networks_take_and_give_grids(name: str, num_in: int, resolution: int) -> None:
    network, cells = fresh(name), 3 * (resolution,)
    assert network.resolution == resolution
    with torch.inference_mode():
        answer = network(torch.rand(2, num_in, *cells))
    if name == "3d-sc":
        code, answer = answer
        assert code.shape == (2, 64)
        assert answer.shape == (2, 2, *cells)
    else:
        assert answer.shape == (2, *cells)
    assert name != "3d-epn" or bool((answer >= 0).all())


def test_weights_are_small_as_half_floats() -> None:
    sizes = {name: num_bytes(name) for name in PEERS}
    assert max(sizes.values()) < MOST_BYTES, sizes
    assert 2 * sum(sizes.values()) < MOST_BYTES_OF_ALL, sizes  # one set for either way


@pytest.mark.parametrize("name", POINT_PEERS)
def test_metric_answers_move_turn_and_grow_with_what_was_seen(name: str) -> None:
    network, cloud, grown = fresh(name), front_of_cylinder(), 1.7
    T = make_T(rotation_about(UP, 0.9), (0.2, 0.1, -0.3))
    assert cloud.viewpoint is not None
    moved = PointCloud(apply_T(T, grown * cloud.points), apply_T(T, grown * cloud.viewpoint[None])[0])
    here, there = (complete_by_peer(detection_of(c), name, network=network) for c in (cloud, moved))
    expected = apply_T(T, grown * np.asarray(here.mesh.vertices))
    assert np.abs(np.asarray(there.mesh.centroid) - apply_T(T, grown * here.mesh.centroid[None])[0]).max() < 0.002
    np.testing.assert_allclose(np.asarray(there.mesh.bounds), [expected.min(axis=0), expected.max(axis=0)], atol=0.004)


@pytest.mark.parametrize("name", GRID_PEERS)
def test_grid_networks_answer_with_a_surface_or_say_that_there_is_none(name: str) -> None:
    """Untrained networks find nothing; a bias makes them find something."""
    network = fresh(name)
    set_bias(network, {"scrg": 0.05, "3d-sc": -0.5}.get(name, 0.0))
    shape = complete_by_peer(detection_of(front_of_cylinder()), name, network=network)
    assert shape.mesh.is_volume
    assert shape.observed.shape == shape.sigma_m.shape == (len(shape.mesh.vertices),)
    assert shape.made_by == "peer"


def test_the_points_join_the_mesh_of_scrg() -> None:
    """A network that holds everything for empty: what is left is what was seen."""
    network = fresh("scrg")
    set_bias(network, -9.0)
    cloud = front_of_cylinder()
    mesh = complete_by_peer(detection_of(cloud), "scrg", network=network).mesh
    assert np.abs(trimesh.proximity.signed_distance(mesh, cloud.points[::50])).max() < 0.004
    np.testing.assert_allclose(mesh.extents, np.ptp(cloud.points, axis=0), atol=0.006)


def test_in_the_true_box_the_answer_is_as_large_as_the_box_says() -> None:
    network, detection = fresh("pcn"), detection_of(front_of_cylinder())
    box = true_box(cylinder(), np.eye(4))
    twice = OrientedBox(box.T_world_box, 2 * np.asarray(box.extents))
    a, b = (complete_by_peer(detection, "pcn", box=own, network=network).mesh for own in (box, twice))
    assert b.extents.max() > 1.3 * a.extents.max()


def test_few_points_are_refused() -> None:
    few = PointCloud(front_of_cylinder().points[:5], EYE)
    with pytest.raises(TooFewPoints, match="5 points, 20 are needed"):
        complete_by_peer(detection_of(few), "pcn", network=fresh("pcn"))


@pytest.fixture
def empty_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """A folder of weights without any."""
    monkeypatch.setattr("gfp_grasp.peers.catalogue.data_dir", lambda name: tmp_path)
    monkeypatch.setattr(stored, "data_file", lambda name, file: tmp_path / file)
    stored.load_network.cache_clear()
    yield tmp_path
    stored.load_network.cache_clear()


@pytest.mark.parametrize("completer", PEER_COMPLETERS)
def test_a_peer_without_weights_says_which_command_trains_it(completer: str, empty_weights: Path) -> None:
    name = completer.removesuffix("-true-box")
    command = f"`gfp-grasp train peer {name}{' --true-box' if completer != name else ''}`"
    with pytest.raises(NotTrained, match="do not ship") as refusal:
        get_completer(completer)
    assert command in str(refusal.value)
    with pytest.raises(NotTrained):
        stored.load_network(name, true_box=completer != name)


@pytest.mark.parametrize("true", [False, True])
def test_weights_that_are_there_are_loaded_once_and_complete(true: bool, empty_weights: Path) -> None:
    stem = weights_stem("topnet", true_box=true)
    save_file(
        {key: tensor.half() for key, tensor in fresh("topnet").state_dict().items()},
        empty_weights / f"{stem}.safetensors",
    )
    check_trained("topnet", true_box=true)
    assert stored.load_network("topnet", true_box=true) is stored.load_network("topnet", true_box=true)
    complete = get_completer("topnet-true-box" if true else "topnet")
    detection = detection_of(front_of_cylinder())
    if true:
        assert isinstance(complete, InTrueBox)
        known = TrueObject("a", "", cylinder(), CollisionMesh((), (0.0, 0.0, 0.0), "hull", 0.0), 0.1, 0.5)
        completion = complete.placed(detection, known, np.eye(4))
    else:
        assert isinstance(complete, partial)
        completion = complete(detection)
    assert completion.category == UNKNOWN
    assert completion.mesh.is_volume


def test_the_true_box_has_to_be_given() -> None:
    complete = InTrueBox("pcn")
    assert isinstance(complete, ToldTruth)
    with pytest.raises(InvalidOption, match="pcn-true-box needs the true box"):
        complete(detection_of(front_of_cylinder()))


def test_peers_need_no_class_and_stand_beside_the_completers_of_the_package() -> None:
    assert not any(needs_class(name) for name in PEER_COMPLETERS)
    assert not set(PEER_COMPLETERS) & set(completers.COMPLETERS)
    assert tuple(PEER_COMPLETERS)[:2] == ("pcn", "pcn-true-box")
    assert not any("/" in name for name in PEER_COMPLETERS)  # which parts a completer from a planner


def test_an_unknown_peer_is_told_what_there_is() -> None:
    for ask in (get_peer, make_network, partial(weights_stem, true_box=False)):
        with pytest.raises(InvalidOption, match="no peer 'magic': choose one of pcn, foldingnet"):
            ask("magic")


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    save_file({"a": torch.zeros(2)}, tmp_path / "own.safetensors")
    with pytest.raises(UnreadableFile, match="holds no weights of a network 'pcn'"):
        read_network("pcn", tmp_path / "own.safetensors")


def test_asking_for_the_names_of_peers_loads_no_torch() -> None:
    code = "import sys; from gfp_grasp.completers import PEER_COMPLETERS; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("name", ["pcn", "pcn-true-box"])
def test_the_bench_of_completions_gives_the_true_box_to_those_that_are_told_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def complete(detection: Detection, name: str, *, box: OrientedBox | None = None) -> CompletedShape:
        asked.append((name, box))
        return CompletedShape(cylinder(), np.zeros(130, dtype=bool), np.full(130, 0.01))

    monkeypatch.setattr("gfp_grasp.peers.complete_by_peer", complete, raising=False)
    monkeypatch.setattr("gfp_grasp.completers.registry.check_trained", lambda name, true_box: None)
    view = view_object(cylinder(), np.random.default_rng(0))
    answer = run_method(name, view, None, "")
    assert answer.completion is not None
    assert answer.completion.category == UNKNOWN
    ((peer, box),) = asked
    assert peer == "pcn"
    assert (box is None) == (name == "pcn")
    if box is not None:
        np.testing.assert_allclose(box.extents, (0.08, 0.08, 0.12), atol=1e-6)
        np.testing.assert_allclose(box.T_world_box[:3, 3], view.mesh.bounds.mean(axis=0), atol=1e-3)


def test_the_bench_refuses_a_peer_without_weights_before_it_begins(empty_weights: Path) -> None:
    with pytest.raises(NotTrained, match="gfp-grasp train peer scrg"):
        bench_completion("cup", methods=("partial", "scrg"), config=CompletionConfig(views=1, limit=1))
