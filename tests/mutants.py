"""Do the tests notice it when the code changes its meaning? `make mutants` tries small changes and counts.

A seeded sample of changes is drawn over all rooms, in proportion to their lines of code. Each change is made in a copy
of the project, never in the working tree, and the tests that execute the changed line are run, quick ones first, until
one fails. A change that no test notices is a survivor: a test is missing, or the change means nothing.
"""

import argparse
import ast
import contextlib
import fnmatch
import gc
import importlib
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import mutation_record
import mutmut
import pytest
import real_data
from mutation_changes import Change, changes_of, is_a_change
from mutation_record import Record

ROOT = Path(__file__).resolve().parents[1]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "gfp_grasp_mutants"
# Libraries that take long to load: each change is tried in a fork of a process that has them.
WARM = "numpy scipy.spatial scipy.sparse.linalg trimesh torch mujoco gymnasium sklearn.cluster PIL.Image typer rich"
# The limit is on processor time, which a busy machine does not stretch; the clock ends a process that waits for ever.
LIMIT_FACTOR, WALL_FACTOR = 6.0, 10.0


@dataclass
class Trial:
    """One change, the tests that were run on it, and what came of it."""

    room: str
    change: Change
    tests: list[str] = field(default_factory=list)
    left_out: int = 0
    limit_s: float = 0.0
    tried: bool = False
    noticed: bool = False
    by: str = ""

    def row(self) -> dict[str, Any]:
        change = self.change
        what = {"file": change.path, "line": change.line, "before": change.before, "after": change.after}
        return what | {"operator": change.operator, "noticed": self.noticed, "by": self.by}


def main() -> None:
    options = _options()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mutants", ignore_cleanup_errors=True) as folder:
        trees = [_copy(options.root, Path(folder) / str(n)) for n in range(options.jobs)]
        _enter(options.package, options.warm.split())
        drawn = draw(trees[0], options.package, options.rooms, options.count, options.seed)
        _say(f"{len(drawn)} changes drawn")
        records = _records(trees, options.package, options.tests, Path(folder))
        mixed = random.Random(options.seed).sample(drawn, len(drawn))
        with contextlib.suppress(KeyboardInterrupt):  # what was tried until then is a sample as well
            signal.signal(signal.SIGTERM, signal.default_int_handler)
            for marker in ("not slow", "slow"):
                for trial in (t for t in mixed if not t.tests):
                    choose_tests(trial, trees[0], options.package, records.get(marker, trial.room), records, options)
                _try_all([t for t in mixed if not t.tried and (t.tests or marker == "slow")], trees, Path(folder))
        drawn = [trial for trial in drawn if trial.tried]
    results = summary(drawn, options.seed, options.count)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    _report(results, drawn, time.perf_counter() - start)


def draw(root: Path, package: str, rooms: list[str], count: int, seed: int) -> list[Trial]:
    """A sample of changes: rooms by their lines of code, then a line, then a change of the line."""
    files: dict[str, list[Path]] = defaultdict(list)
    for path in sorted((root / package).rglob("*.py")):
        files[path.relative_to(root / package).parts[0].removesuffix(".py")].append(path)
    files = {room: paths for room, paths in files.items() if not rooms or room in rooms}
    unknown = set(rooms) - set(files)
    if unknown:
        raise SystemExit(f"no such room: {', '.join(sorted(unknown))}")
    code = {room: sum(_lines_of_code(path) for path in paths) for room, paths in files.items()}
    return [
        trial
        for room, share in _shares(code, count).items()
        for trial in _draw_room(root, room, files[room], share, random.Random(f"{seed} {room}"))
    ]


def choose_tests(
    trial: Trial, tree: Path, package: str, known: list[Record], records: "_Records", options: argparse.Namespace
) -> None:
    """Tests that execute the changed line, then those that execute the module; the room's own and quick ones first."""
    exact, module = _executing(trial.change, tree, package, known)
    if not exact:
        return
    seconds = records.seconds
    own = set(records.own_files(trial.room))
    order = [
        sorted(tests, key=lambda t: (t.split("::")[0] not in own, seconds[t], t)) for tests in (exact, module - exact)
    ]
    spent = 0.0
    for test in [*order[0], *order[1]]:
        if spent + seconds[test] > options.budget and trial.tests:
            trial.left_out += test in exact
            continue
        spent += seconds[test]
        trial.tests.append(test)
    trial.limit_s = options.limit + LIMIT_FACTOR * spent


def summary(trials: list[Trial], seed: int, count: int) -> dict[str, Any]:
    """What is committed: figures by room, survivors with the tests that ran, and every change that was tried."""
    tried, noticed = Counter(t.room for t in trials), Counter(t.room for t in trials if t.noticed)
    return {
        "command": f"make mutants COUNT={count} SEED={seed}",
        "operators": f"mutmut {mutmut.__version__}",
        "noticed": sum(noticed.values()),
        "of": len(trials),
        "rooms": {room: {"noticed": noticed[room], "of": tried[room]} for room in sorted(tried)},
        "survivors": [
            trial.row() | {"tests": len(trial.tests), "tests_left_out": trial.left_out, "ran": trial.tests[:8]}
            for trial in trials
            if not trial.noticed
        ],
        "changes": [trial.row() for trial in trials],
    }


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rooms", nargs="*", default=[], help="rooms of the package; all of them by default")
    parser.add_argument("--count", type=int, default=200, help="how many changes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--tests", nargs="*", default=["test_*.py"], help="patterns of the test files that may be run")
    parser.add_argument("--budget", type=float, default=20.0, help="seconds of tests that a change may cost")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds that a change may cost beyond its tests")
    parser.add_argument("--jobs", type=int, default=1, help="changes tried side by side")
    parser.add_argument("--root", type=Path, default=ROOT, help="project with the package and tests/")
    parser.add_argument("--package", default="gfp_grasp")
    parser.add_argument("--warm", default=WARM, help="libraries to load once")
    return parser.parse_args()


def _copy(root: Path, tree: Path) -> Path:
    """A copy of what git tracks or would track, in a repository of its own, compiled."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.split("\0")
    for name in filter(None, listed):
        if (root / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, tree / name)
    for command in (["git", "init", "-q"], ["git", "add", "-A"]):
        subprocess.run(command, cwd=tree, check=True)
    # A compiled file is used only where the source is what it was made from, whatever the clock says.
    compiling = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "."]
    subprocess.run(compiling, cwd=tree, check=False, stdout=subprocess.DEVNULL)
    return tree


def _enter(package: str, libraries: list[str]) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    os.environ.setdefault(real_data.VARIABLE, str(real_data.BESIDE_THE_CHECKOUT))
    for name in libraries:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryDirectory() as empty:
        pytest.main(["--version", "--version", "-c", os.devnull, "--rootdir", empty, empty])  # loads the plugins
    if package in sys.modules:
        raise SystemExit(f"{package} was loaded before it was changed: no change would be seen")
    gc.freeze()  # what is loaded is not searched for garbage after each change


def _lines_of_code(path: Path) -> int:
    return sum(
        bool(line.strip()) and not line.lstrip().startswith("#") for line in path.read_text("utf-8").splitlines()
    )


def _shares(sizes: dict[str, int], count: int) -> dict[str, int]:
    """Whole shares of the count in proportion to the sizes, by the largest remainders; at least one each."""
    exact = {name: count * size / max(sum(sizes.values()), 1) for name, size in sizes.items()}
    shares = {name: max(int(share), 1) for name, share in exact.items()}
    by_remainder = sorted(exact, key=lambda name: exact[name] - int(exact[name]), reverse=True)
    for name in by_remainder[: max(count - sum(shares.values()), 0)]:
        shares[name] += 1
    return shares


def _draw_room(root: Path, room: str, files: list[Path], share: int, rng: random.Random) -> list[Trial]:
    by_line: dict[tuple[str, int], list[Change]] = defaultdict(list)
    for path in files:
        for change in changes_of(root, path.relative_to(root).as_posix()):
            by_line[change.path, change.line].append(change)
    trials: list[Trial] = []
    for place in rng.sample(sorted(by_line), len(by_line)):
        change = rng.choice(by_line[place])
        if len(trials) < share and is_a_change((root / change.path).read_text("utf-8"), change.source()):
            trials.append(Trial(room, change))
    return trials


class _Records:
    """Records of the test files, made where they are missing."""

    def __init__(
        self, files: list[str], package: str, tree: Path, make: Callable[[list[tuple[str, str]]], None]
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._files, self._package, self._tree, self._make = files, package, tree, make
        self._known: dict[tuple[str, str], Record] = {}

    def get(self, marker: str, room: str) -> list[Record]:
        """Of all files; the slow tests only of the files that name the room."""
        files = self._files
        if marker == "slow":
            files = [f for f in self.own_files(room) if "mark.slow" in (self._tree / f).read_text(encoding="utf-8")]
        wanted = [(file, marker) for file in files if (file, marker) not in self._known]
        if wanted:
            self._make(wanted)
        for file, _ in wanted:
            found = mutation_record.kept_record(self._tree, file, marker, CACHE)
            self._known[file, marker] = found or Record({}, [], {}, {})
            self.seconds |= self._known[file, marker].seconds
        return [self._known[file, marker] for file in files]

    def own_files(self, room: str) -> list[str]:
        return [
            file
            for file in self._files
            if Path(file).stem.startswith(f"test_{room}")
            or f"{self._package}.{room}" in (self._tree / file).read_text(encoding="utf-8")
        ]


def _records(trees: list[Path], package: str, patterns: list[str], scratch: Path) -> _Records:
    files = sorted(f"tests/{path.name}" for path in (trees[0] / "tests").glob("test_*.py"))

    def make(wanted: list[tuple[str, str]]) -> None:
        missing = [(f, k) for f, k in wanted if mutation_record.kept_record(trees[0], f, k, CACHE) is None]
        if missing:
            _say(f"recording what the tests of {len(missing)} files execute")
        waiting, running = list(reversed(missing)), {}
        while waiting or running:
            while waiting and len(running) < len(trees):
                file, marker = waiting.pop()
                place = scratch / f"record-{Path(file).stem}-{len(marker)}"
                place.mkdir(exist_ok=True)
                work = partial(mutation_record.record, trees[0], package, file, marker, CACHE, place)
                running[_fork(trees[0], place / "log", work)] = file
            pid, _ = os.wait()
            _say(f"  {len(missing) - len(waiting) - len(running) + 1}/{len(missing)} {running.pop(pid)}")

    return _Records(
        [f for f in files if any(fnmatch.fnmatch(Path(f).name, pattern) for pattern in patterns)],
        package,
        trees[0],
        make,
    )


def _executing(change: Change, tree: Path, package: str, records: list[Record]) -> tuple[set[str], set[str]]:
    """Tests that execute the changed line (or what uses a value made at import), and those of the whole module."""
    places = list(_places(change, tree, package))
    exact: set[str] = set()
    module: set[str] = set()
    for kept in records:
        for path, first, last in places:
            for line, tests in kept.lines.get(path, {}).items():
                if first <= line <= last:
                    exact |= tests
        for tests in kept.lines.get(change.path, {}).values():
            module |= tests
    return (exact or module if change.at_import else exact), module


def _places(change: Change, tree: Path, package: str) -> Iterator[tuple[str, int, int]]:
    if change.body is not None:
        yield change.path, *change.body
    elif not change.at_import:
        yield change.path, *change.lines
    elif change.names:
        for path in sorted((tree / package).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if any(name in source for name in change.names):
                for node in ast.walk(ast.parse(source)):
                    used = node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", None)
                    if used in change.names and isinstance(node, ast.expr):
                        yield path.relative_to(tree).as_posix(), node.lineno, node.end_lineno or node.lineno


def _try_all(trials: list[Trial], trees: list[Path], scratch: Path) -> None:
    """Try the changes, as many side by side as there are copies."""
    waiting, running, done = list(reversed(trials)), {}, 0
    try:
        while waiting or running:
            for tree in trees:
                while waiting and tree not in {r.tree for r in running.values()}:
                    trial = waiting.pop()
                    if trial.tests:
                        started = _start(trial, tree, scratch)
                        running[started.pid] = started
                    else:
                        done += 1
                        _tell(trial, done, len(trials))
            for pid, run in list(running.items()):
                late = time.perf_counter() > run.until
                if late:
                    _kill(pid)
                ended, status = os.waitpid(pid, 0 if late else os.WNOHANG)
                if ended:
                    del running[pid]
                    done += 1
                    _finish(run, late, status)
                    _tell(run.trial, done, len(trials))
            time.sleep(0.02)
    finally:
        for pid in running:
            _kill(pid)
            os.waitpid(pid, 0)


@dataclass
class _Run:
    trial: Trial
    tree: Path
    pid: int
    until: float
    original: str
    verdict: Path


def _start(trial: Trial, tree: Path, scratch: Path) -> _Run:
    path = tree / trial.change.path
    original = path.read_text(encoding="utf-8")
    path.write_text(trial.change.source(), encoding="utf-8")
    verdict = scratch / f"verdict-{tree.name}"
    verdict.write_text("", encoding="utf-8")
    pid = _fork(tree, scratch / f"log-{tree.name}", lambda: _run_tests(trial, verdict))
    return _Run(trial, tree, pid, time.perf_counter() + WALL_FACTOR * trial.limit_s, original, verdict)


def _run_tests(trial: Trial, verdict: Path) -> None:
    class Witness:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                verdict.write_text(report.nodeid, encoding="utf-8")
                os._exit(1)

    seconds = int(time.process_time() + trial.limit_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    code = pytest.main(["-x", *mutation_record.arguments(), *trial.tests], plugins=[Witness()])
    if code and not verdict.read_text(encoding="utf-8"):
        verdict.write_text("import", encoding="utf-8")


def _finish(run: _Run, late: bool, status: int) -> None:
    _kill(run.pid)
    hung = late or (os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL))
    run.trial.by = "time limit" if hung else run.verdict.read_text(encoding="utf-8") or ("crash" if status else "")
    run.trial.noticed = bool(run.trial.by)
    (run.tree / run.trial.change.path).write_text(run.original, encoding="utf-8")


def _fork(tree: Path, log: Path, work: Callable[[], None]) -> int:
    """Run work in a forked process, the leader of a group of its own, within the copy."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        os.setsid()
        with log.open("wb") as out:
            os.dup2(out.fileno(), 1)
            os.dup2(out.fileno(), 2)
        os.chdir(tree)
        os.environ["PYTHONPATH"] = str(tree)
        sys.path[:] = [str(tree), *(place for place in sys.path if place != str(ROOT / "tests"))]
        work()
        code = 0
    finally:
        os._exit(code)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def _tell(trial: Trial, done: int, total: int) -> None:
    trial.tried = True
    change = trial.change
    word = "noticed " if trial.noticed else "survived"
    _say(f"{done}/{total} {word} {change.path}:{change.line} {change.before} -> {change.after} [{trial.by}]")


def _report(results: dict[str, Any], trials: list[Trial], seconds: float) -> None:
    _say("\nSurvivors:")
    for trial in (t for t in trials if not t.noticed):
        change = trial.change
        _say(f"{change.path}:{change.line} ({change.operator}) {change.before}  ->  {change.after}")
        _say(f"    {len(trial.tests)} tests ran: {', '.join(trial.tests[:4]) or 'no test executes the line'}")
    for room, figures in results["rooms"].items():
        _say(f"{room:14} {figures['noticed']:3} of {figures['of']:3}")
    _say(f"{results['noticed']} of {results['of']} noticed ({seconds:.0f} s)")


if __name__ == "__main__":
    main()
