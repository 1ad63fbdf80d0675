"""What `bench_peers` compares: groups of things by class and by what is hidden of them, and the networks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gfp_grasp.bench.completion import CompletionConfig
from gfp_grasp.completers import PEER_COMPLETERS, check_network
from gfp_grasp.errors import InvalidOption, NotTrained
from gfp_grasp.peers import PEERS, get_peer
from gfp_grasp.scenes import ObjectSource, load_objects
from gfp_grasp.shapes import HOUSEHOLD, IN_PAPER, MIXTURES, TRAFFIC
from gfp_grasp.types import UNKNOWN

HIDDEN = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
GROUPS: Mapping[str, tuple[str, ...]] = {
    **{name: (name,) for name in IN_PAPER},
    "household": HOUSEHOLD,
    UNKNOWN: tuple(MIXTURES),
}


@dataclass(frozen=True)
class PeersConfig:
    """What is compared.

    Attributes:
        peers: Some of `gfp_grasp.peers.PEERS`; each is measured in both ways, where its weights are there.
        views: Number of views of each object.
        limit: Most objects of each group; families take turns, and of a folder the first are taken.
        seed: Seed of all views.
        data: Folder of meshes `<class>__<name>`, or `<name>` for things of no class, that are completed and grasped in
            place of the procedural test split.
        kitti: Tree of scans, as `bench_kitti` takes it; None leaves this out.
        with_score: Whether grasps are tried in the simulator.
    """

    peers: tuple[str, ...] = tuple(PEERS)
    views: int = 1
    limit: int = 60
    seed: int = 0
    data: Path | None = None
    kitti: Path | None = None
    with_score: bool = True

    def __post_init__(self) -> None:
        for name in self.peers:
            get_peer(name)
        if not self.peers or len(set(self.peers)) < len(self.peers):
            raise InvalidOption(f"peers are {self.peers}; some of {', '.join(PEERS)} are expected, each but once")
        if min(self.views, self.limit) < 1:
            raise InvalidOption(f"views is {self.views} and limit {self.limit}; at least 1 of each is expected")
        for folder in (self.data, self.kitti):
            if folder is not None and not folder.is_dir():
                raise InvalidOption(f"{folder} is no folder: data is one of meshes, kitti one of scans")


@dataclass(frozen=True)
class Group:
    """Things that are looked at in one way; `hidden` is the share of them behind a board, None without one."""

    name: str
    sources: tuple[ObjectSource, ...]
    views: CompletionConfig
    hidden: float | None = None


def groups_of(config: PeersConfig) -> Iterator[Group]:
    """Groups that have an object.

    Raises:
        InvalidOption: There is none.
    """
    found = {name: sources_of(config, families) for name, families in GROUPS.items()}
    if not any(found.values()):
        asked = ", ".join(dict.fromkeys((*IN_PAPER, *HOUSEHOLD)))
        raise InvalidOption(f"no object of {config.data} is of a class that is compared ({asked}) or of none")
    for name, sources in found.items():
        protocol = "lidar" if set(GROUPS[name]) <= set(TRAFFIC) else "standard"
        if sources:
            yield Group(name, sources, CompletionConfig(config.views, config.seed, protocol=protocol))
    behind = sources_of(config, [name for name in IN_PAPER if name in HOUSEHOLD])
    for share in HIDDEN if behind else ():
        views = CompletionConfig(config.views, config.seed, protocol="hidden", hidden_share=share)
        yield Group(f"hidden {share}", behind, views, share)


def sources_of(config: PeersConfig, families: Sequence[str]) -> tuple[ObjectSource, ...]:
    """The objects of some families, or the meshes of their classes in the folder that is compared."""
    if config.data is None:
        return load_objects(",".join(families), limit=config.limit)
    categories = {"" if family in MIXTURES else family for family in families}
    return tuple(source for source in load_objects(config.data) if source.category in categories)[: config.limit]


def trained_of(peers: Sequence[str], before: Collection[str]) -> tuple[tuple[str, ...], list[dict[str, str]]]:
    """Completers of the peers that are asked for or were measured before, and those of them that have no weights."""
    trained, left_out = [], []
    for completer, (name, _) in PEER_COMPLETERS.items():
        if name not in peers and completer not in before:
            continue
        try:
            check_network(completer)
            trained.append(completer)
        except NotTrained as error:
            left_out.append({"method": completer, "why": str(error)})
    return tuple(trained), left_out
