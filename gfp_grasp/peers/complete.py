"""From a detection to the completed shape of a peer, in either way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.errors import NoSurface, TooFewPoints
from gfp_grasp.level import MIN_POINTS, mark_shape
from gfp_grasp.parallel import one_thread
from gfp_grasp.peers.cube import cube_of_box, cube_of_seen, tidied
from gfp_grasp.peers.network import PeerNetwork
from gfp_grasp.peers.seen import seen_in
from gfp_grasp.peers.weights import load_network
from gfp_grasp.types import CompletedShape, Detection, OrientedBox


@one_thread()
def complete_by_peer(
    detection: Detection, name: str, *, box: OrientedBox | None = None, network: PeerNetwork | None = None
) -> CompletedShape:
    """Complete an object by a peer.

    Args:
        detection: One object, at least `level.MIN_POINTS` points; its points, viewpoint and up are looked at.
        name: One of PEERS.
        box: The true box, world frame, for the way of the papers; None is the metric way, in a cube around what was
            seen.
        network: None takes the shipped one of that way.

    Returns:
        The completed shape in the detection's frame, as the network says it: not moved to the points or the support,
        but for `scrg`, whose paper has the points join it.

    Raises:
        InvalidOption: No such peer.
        NotTrained: Its weights are not there.
        TooFewPoints: Too few points.
        NoSurface: The network finds nothing solid.
    """
    count = len(detection.cloud.points)
    if count < MIN_POINTS:
        raise TooFewPoints(f"cloud has {count} points, {MIN_POINTS} are needed: is the object in view?")
    network = network or load_network(name, true_box=box is not None)
    cloud = tidied(detection.cloud)
    cube = cube_of_seen(cloud, detection.up) if box is None else cube_of_box(box)
    surface = network.surface(seen_in(cube, cloud))
    mesh = trimesh.Trimesh(cube.outward(np.asarray(surface.vertices)), np.asarray(surface.faces), process=False)
    if not mesh.is_volume:
        raise NoSurface(
            f"the surface of the peer {name!r} is no watertight volume: try other views, or another completer"
        )
    return replace(mark_shape(mesh, detection), made_by="peer")
