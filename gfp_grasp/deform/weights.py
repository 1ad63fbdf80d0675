"""Weights of the GFPNets and their cards: those that ship, and those of a file."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from torch import nn

from gfp_grasp.assets import data_file
from gfp_grasp.deform.gfpnet import Variant, make_network
from gfp_grasp.networks import with_weights

WEIGHTS = {"patch": "gfpnet", "paper-iterative": "gfpnet_paper", "paper-oneshot": "gfpnet_oneshot"}


@lru_cache(maxsize=4)
def load_network(variant: Variant) -> nn.Module:
    """The shipped network of one variant, in evaluation mode, loaded once."""
    return read_network(variant, data_file("weights", f"{WEIGHTS[variant]}.safetensors"))


def read_network(variant: Variant, path: Path) -> nn.Module:
    """A network of one variant with the weights of a file, in evaluation mode.

    Raises:
        UnreadableFile: The file holds no weights of this variant.
    """
    return with_weights(make_network(variant), path, name=variant)


@lru_cache(maxsize=4)
def load_card(variant: Variant) -> dict[str, Any]:
    """How the shipped weights came to be: command, seed, data, hours, metrics, sha256."""
    return json.loads(data_file("weights", f"{WEIGHTS[variant]}.json").read_text())


_LEAST_GAIN = 0.05


def pays_on(name: str) -> bool:
    """Whether the network that answers for each point may move a primitive of this name.

    It may where it took at least a twentieth off what the fits of the validation split left over, as its card says, and
    where the card says nothing, as of a class of one's own.
    """
    metrics = load_card("patch")["metrics"]
    before, after = (metrics.get(f"{name}_error_{when}_mm") for when in ("before", "after"))
    return before is None or after is None or after <= (1.0 - _LEAST_GAIN) * before
