"""The training loop to the number: first steps of Adam, the schedule, resumption, batches and what is written."""

import hashlib
import json
import stat
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from gfp_grasp.errors import CannotWrite, InvalidOption, TrainingDiverged
from gfp_grasp.train import LoopConfig, shuffled, train
from gfp_grasp.train.loop import command_line, write_weights

CONFIG = LoopConfig(steps=1, batch=2, rate=0.01, bf16=False)


class _Weight(nn.Module):
    def __init__(self, value: float = 3.0) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor([value]))


def _ones(_: torch.Generator):
    while True:
        yield (torch.ones(2, 1, dtype=torch.float16),)


def _steep(network: nn.Module, batch) -> torch.Tensor:
    assert batch[0].dtype == torch.float32  # stored in less, used in single precision
    return (1000.0 * network.weight * batch[0]).mean()  # type: ignore[operator]


def _trained(tmp_path: Path, config: LoopConfig = CONFIG, loss=_steep, batches=_ones, name: str = "c.pt"):
    told: list[tuple[int, float]] = []
    network, hours = train(
        _Weight(), batches, loss, config=config, checkpoint=tmp_path / "new" / name, report=lambda *t: told.append(t)
    )
    assert 0 <= hours < 0.1
    assert isinstance(network, _Weight)
    return network, told, torch.load(tmp_path / "new" / name, weights_only=True)


def test_the_first_step_of_adam_has_the_length_of_the_rate(tmp_path: Path) -> None:
    network, told, state = _trained(tmp_path)
    assert network.weight.item() == pytest.approx(2.99, abs=1e-6)
    assert not network.training
    assert told == [(1, pytest.approx(3000.0))]
    assert state["done"] == 1
    assert state["seconds"] >= 0


def test_hours_are_those_of_the_processor_and_go_on_with_a_resumed_run(tmp_path: Path) -> None:
    def slow(network: nn.Module, batch) -> torch.Tensor:
        time.sleep(0.5)  # another process has the core
        end = time.process_time() + 0.1
        while time.process_time() < end:
            pass
        return _steep(network, batch)

    _, _, state = _trained(tmp_path, loss=slow)
    assert 0.1 <= state["seconds"] < 0.5
    checkpoint = tmp_path / "new" / "c.pt"
    _, hours = train(_Weight(), _ones, slow, config=replace(CONFIG, steps=2), checkpoint=checkpoint)
    assert 0.2 <= 3600 * hours < 0.7


def test_weights_decay_by_rate_times_decay(tmp_path: Path) -> None:
    network, _, _ = _trained(tmp_path, replace(CONFIG, weight_decay=0.5))
    assert network.weight.item() == pytest.approx(3.0 * (1 - 0.01 * 0.5) - 0.01, abs=1e-6)


def test_gradients_are_cut_to_length_one(tmp_path: Path) -> None:
    """Adam's running mean of the gradient holds a tenth of the first one."""
    _, _, state = _trained(tmp_path)
    assert state["optimiser"]["state"][0]["exp_avg"].item() == pytest.approx(0.1, rel=1e-4)


def test_the_rate_falls_ten_times_over_the_schedule(tmp_path: Path) -> None:
    _, _, state = _trained(tmp_path, replace(CONFIG, steps=40))
    assert state["optimiser"]["param_groups"][0]["lr"] == pytest.approx(0.01 * 0.92**10)
    _, _, state = _trained(tmp_path, replace(CONFIG, steps=30, decay=0.5), name="d.pt")
    assert state["optimiser"]["param_groups"][0]["lr"] == pytest.approx(0.01 * 0.5**10)


def test_a_run_goes_on_from_its_checkpoint_with_other_batches(tmp_path: Path) -> None:
    seeds: list[int] = []

    def batches(generator: torch.Generator):
        seeds.append(generator.initial_seed())
        yield from _ones(generator)

    _trained(tmp_path, replace(CONFIG, steps=4, seed=2), batches=batches)
    network, told, state = _trained(tmp_path, replace(CONFIG, steps=7, seed=2), batches=batches)
    assert seeds == [2_000_006, 2_000_010]
    assert [step for step, _ in told] == [5, 6, 7]
    assert state["done"] == 7
    assert network.weight.item() < 3.0 - 0.05
    again, told, _ = _trained(tmp_path, replace(CONFIG, steps=7, seed=2), batches=batches)
    assert told == []
    assert again.weight.item() == network.weight.item()


def test_a_run_that_is_to_stop_on_the_way_goes_on_by_the_schedule_of_the_whole(tmp_path: Path) -> None:
    whole, _, _ = _trained(tmp_path, replace(CONFIG, steps=40), name="whole.pt")
    checkpoint, config = tmp_path / "parts.pt", replace(CONFIG, steps=40)
    for until, expected in ((13, 13), (26, 26), (20, 26), (50, 40), (None, 40)):
        network, _ = train(_Weight(), _ones, _steep, config=config, checkpoint=checkpoint, until=until)
        assert torch.load(checkpoint, weights_only=True)["done"] == expected
    assert network.weight.item() == pytest.approx(whole.weight.item(), abs=1e-6)


def test_reports_are_means_since_the_last_one_a_hundred_times_over_the_schedule(tmp_path: Path) -> None:
    values = iter(range(1, 401))

    def counted(network: nn.Module, batch) -> torch.Tensor:
        return 0 * network.weight.sum() + float(next(values))  # type: ignore[operator]

    _, told, _ = _trained(tmp_path, replace(CONFIG, steps=400), counted)
    assert len(told) == 100
    assert told[0] == (4, pytest.approx(2.5))
    assert told[-1] == (400, pytest.approx(398.5))


def test_a_checkpoint_is_written_whenever_its_time_has_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[int] = []
    monkeypatch.setattr("gfp_grasp.train.loop._save_checkpoint", lambda *args: saved.append(args[4]))
    for seconds, steps in ((-1.0, [1, 2, 3]), (1e9, [3])):
        saved.clear()
        train(
            _Weight(),
            _ones,
            _steep,
            config=replace(CONFIG, steps=3, checkpoint_s=seconds),
            checkpoint=tmp_path / "none",
        )
        assert saved == steps


def test_a_checkpoint_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _trained(tmp_path)
    before = (tmp_path / "new" / "c.pt").read_bytes()

    def half(state: object, file) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", half)
    with pytest.raises(CannotWrite, match=r"c\.pt cannot be written \(No space"):
        _trained(tmp_path, replace(CONFIG, steps=2))
    assert (tmp_path / "new" / "c.pt").read_bytes() == before
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["c.pt"]


@pytest.mark.parametrize("bad", ["nan", "inf", "gradient"])
def test_a_loss_that_is_no_number_ends_the_run_before_it_spoils_the_weights(bad: str, tmp_path: Path) -> None:
    """The third step is bad; every step is checkpointed, and no report is asked for."""
    steps = iter(range(1, 9))

    def spoilt(network: nn.Module, batch) -> torch.Tensor:
        value = _steep(network, batch)
        if next(steps) < 3:
            return value
        # The root of nothing has an infinite slope, and nothing times that is no number.
        return value + (0 * value).sqrt() if bad == "gradient" else value * float(bad)

    config, checkpoint = replace(CONFIG, steps=800, checkpoint_s=-1.0), tmp_path / "c.pt"
    with pytest.raises(TrainingDiverged, match=r"at step 3 the loss is .*a rate lower than 0\.01 helps"):
        train(_Weight(), _ones, spoilt, config=config, checkpoint=checkpoint)
    state = torch.load(checkpoint, weights_only=True)
    assert state["done"] == 2
    assert state["network"]["weight"].item() == pytest.approx(2.98, abs=1e-4)


def test_products_are_taken_in_half_precision_where_asked(tmp_path: Path) -> None:
    kinds: list[torch.dtype] = []

    def product(network: nn.Module, batch) -> torch.Tensor:
        value = batch[0] @ network.weight[:, None]  # type: ignore[index]
        kinds.append(value.dtype)
        return value.float().mean()

    _trained(tmp_path, CONFIG, product)
    _trained(tmp_path, replace(CONFIG, bf16=True), product, name="b.pt")
    assert kinds == [torch.float32, torch.bfloat16]


@pytest.mark.parametrize("nonsense", [{"steps": 0}, {"batch": 0}, {"rate": 0.0}, {"decay": 0.0}, {"decay": 1.01}])
def test_a_schedule_that_is_none_is_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        replace(CONFIG, **nonsense)


def test_a_schedule_without_decay_is_one() -> None:
    assert replace(CONFIG, decay=1.0).decay == 1.0
    defaults = LoopConfig(steps=1, batch=1)
    assert (defaults.rate, defaults.decay, defaults.weight_decay, defaults.seed) == (1e-4, 0.92, 0.0, 0)
    assert (defaults.bf16, defaults.checkpoint_s, defaults.device) == (True, 60.0, "cpu")


def test_batches_are_drawn_without_replacement_pass_after_pass() -> None:
    parts = (torch.arange(10), torch.arange(10) * 7)
    stream = shuffled(parts, 5)(torch.Generator().manual_seed(0))
    passes = [torch.cat([next(stream)[0] for _ in range(2)]) for _ in range(3)]
    assert all(sorted(one.tolist()) == list(range(10)) for one in passes)
    assert len({tuple(one.tolist()) for one in passes}) == 3
    number, sevenfold = next(stream)
    assert (sevenfold == 7 * number).all()


def test_what_is_left_over_of_a_pass_is_no_batch_but_fewer_samples_than_a_batch_are() -> None:
    stream = shuffled((torch.arange(11),), 4)(torch.Generator().manual_seed(0))
    first, second = next(stream)[0], next(stream)[0]
    assert len({*first.tolist(), *second.tolist()}) == 8
    assert all(len(next(stream)[0]) == 4 for _ in range(6))
    few = shuffled((torch.arange(3),), 4)(torch.Generator().manual_seed(0))
    assert sorted(next(few)[0].tolist()) == [0, 1, 2]


@dataclass(frozen=True)
class _Settings:
    seed: int = 5


def test_weights_are_written_in_half_precision_beside_a_card_that_knows_their_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/gfp-grasp", "train", "--seed", "5"])
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)
    path = tmp_path / "new" / "net.safetensors"
    card_path = write_weights(
        _Weight(0.1), path, config=_Settings(), data={"a": 1}, hours=1.23456, metrics={"m": 2}, extra={"more": 3}
    )
    assert load_file(path)["weight"].dtype == torch.float16
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert card_path == tmp_path / "new" / "net.json"
    card = json.loads(card_path.read_text())
    assert card == {
        "command": "gfp-grasp train --seed 5",
        "config": {"seed": 5},
        "data": {"a": 1},
        "hours": 1.235,
        "torch": torch.__version__.split("+")[0],
        "metrics": {"m": 2},
        "more": 3,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    assert card_path.read_text().endswith("}\n")


def test_weights_and_card_are_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "net.safetensors"
    how = {"config": _Settings(), "data": {}, "metrics": {}}
    card = write_weights(_Weight(0.5), path, hours=1.0, **how)
    before = (path.read_bytes(), card.read_bytes())
    monkeypatch.setattr(Path, "replace", lambda self, to: _no_room())
    with pytest.raises(CannotWrite, match=r"net\.safetensors cannot be written"):
        write_weights(_Weight(0.25), path, hours=2.0, **how)
    assert (path.read_bytes(), card.read_bytes()) == before
    replaced = Path.rename  # as replace does where it may
    monkeypatch.setattr(Path, "replace", lambda self, to: _no_room() if to == card else replaced(self, to))
    with pytest.raises(CannotWrite, match=r"net\.json cannot be written"):
        write_weights(_Weight(0.25), path, hours=2.0, **how)
    assert load_file(path)["weight"].item() == 0.25
    assert card.read_bytes() == before[1]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["net.json", "net.safetensors"]


def _no_room() -> None:
    raise OSError(28, "No space left on device")


def test_a_module_that_is_run_is_named_as_a_user_would_type_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["whatever", "x"])
    for name, command in (("gfp_grasp.cli.__main__", "python -m gfp_grasp.cli x"), ("a.b", "python -m a.b x")):
        monkeypatch.setattr(sys.modules["__main__"], "__spec__", type("Spec", (), {"name": name}))
        assert command_line() == command
