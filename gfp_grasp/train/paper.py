"""How the paper's networks learn: from patches one by one, by Chamfer distance and Laplacian.

Letters: b patches, n source points, k neighbours.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn

from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train.labels import make_labels
from gfp_grasp.train.loop import Batch
from gfp_grasp.train.patch_data import PrimitiveTable, load_objects, single_patches

_CHAMFER_SHARE = 0.7  # the paper's loss: 0.7 Chamfer distance + 0.3 Laplacian
_NEIGHBOURS = 8


def paper_loss(network: nn.Module, batch: Batch) -> Tensor:
    """The paper's eq. 1: 0.7 times the Chamfer distance to the label and 0.3 times the Laplacian's.

    Its eq. 3 as printed, the mean position of the neighbours, has no useful minimum; the Laplacian here is the
    distance of each point to the mean of its neighbours on S, less the label's own.
    """
    source, template, target, _ = batch
    moved = network(source, template).float()
    pairwise = torch.cdist(moved, target)
    chamfer = pairwise.amin(dim=2).mean() + pairwise.amin(dim=1).mean()
    near = torch.cdist(source, source).topk(_NEIGHBOURS + 1, largest=False).indices[..., 1:]
    laplacian = (_lap(moved, near).norm(dim=-1) - _lap(target, near).norm(dim=-1)).abs().mean()
    return _CHAMFER_SHARE * chamfer + (1 - _CHAMFER_SHARE) * laplacian


def _lap(points: Tensor, near: Tensor) -> Tensor:
    b, n, k = near.shape
    around = torch.gather(points[:, None].expand(b, n, n, 3), 2, near[..., None].expand(b, n, k, 3))
    return points - around.mean(dim=2)


def patches_of_split(split: str, num_views: int, limit: int | None, runs: Path, workers: int = 1) -> Batch:
    """S, T, label (b, n, 3) and unit (b,) of a split's patches that see something: what the paper's networks learn."""
    library = PrimitiveLibrary.shipped()
    make = partial(
        make_labels, library=library, split=split, num_views=num_views, limit=limit, runs=runs, workers=workers
    )
    objects, _ = load_objects(make, PrimitiveTable.of(library, library.categories))
    return single_patches(objects)


def measure_paper(network: nn.Module, data: Batch) -> dict[str, float]:
    """Mean distance of the patches' points to the labels, mm, undeformed and as their nearest of the predicted set."""
    source, template, target, unit_m = data
    after = []
    with torch.inference_mode():
        for s, t, wanted in zip(source.split(512), template.split(512), target.split(512), strict=True):
            after.append(torch.cdist(network(s.float(), t.float()), wanted.float()).amin(dim=1))
    return {
        "val_samples": len(source),
        "mean_error_before_mm": mean_mm(unit_m[:, None] * (target - source).float().norm(dim=-1)),
        "mean_error_after_mm": mean_mm(unit_m[:, None] * torch.cat(after)),
    }


def mean_mm(distance_m: Tensor) -> float:
    """Mean of distances, in millimetres as a card says them."""
    return round(float(distance_m.mean()) * 1000, 3)
