"""Which test executes which lines of the package, recorded once for each test file and kept until either changes."""

import hashlib
import json
import os
import sys
from collections import defaultdict
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path

import coverage
import pytest

LONGEST_S = 120.0  # of processor time, for one file
Lines = dict[str, dict[int, set[str]]]  # module, line, tests


@dataclass
class Record:
    """Tests of one file, as they ran on the unchanged package.

    Attributes:
        seconds: Processor time of each test that passed.
        failed: Tests that did not pass; no change is tried on them.
        lines: Tests by module and line.
        modules: Digest of each module that was executed.
    """

    seconds: dict[str, float]
    failed: list[str]
    lines: Lines
    modules: dict[str, str]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def kept_record(tree: Path, test_file: str, marker: str, cache: Path) -> Record | None:
    """The record of an earlier run, if neither the test file nor a module that it executes has changed."""
    try:
        found = json.loads(_place(tree, test_file, marker, cache).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if any(digest(tree / path) != known for path, known in found["modules"].items()):
        return None
    names = found["names"]
    lines = {
        path: {int(line): {names[i] for i in tests} for line, tests in by_line.items()}
        for path, by_line in found["lines"].items()
    }
    return Record(found["seconds"], found["failed"], lines, found["modules"])


def record(tree: Path, package: str, test_file: str, marker: str, cache: Path, scratch: Path) -> None:
    """Run the tests of one file under coverage and keep what they executed. Call it in a process of its own."""
    plugin = _Recorder(_subprocess_coverage(tree, package, scratch))
    sys.dont_write_bytecode = False  # pytest keeps the tests as it rewrote them
    plugin.coverage.start()
    pytest.main([test_file, *arguments(marker)], plugins=[plugin])
    plugin.coverage.stop()
    plugin.coverage.save()
    lines: Lines = defaultdict(lambda: defaultdict(set))
    for data_file in scratch.glob(".coverage*"):
        data = coverage.CoverageData(basename=str(data_file))
        data.read()
        for measured in data.measured_files():
            path = Path(measured)
            if path.is_relative_to(tree):
                for line, contexts in data.contexts_by_lineno(measured).items():
                    lines[path.relative_to(tree).as_posix()][line] |= plugin.tests_of(contexts)
        data.close()
    names = sorted(plugin.seconds)
    place = {name: i for i, name in enumerate(names)}
    content = {
        "seconds": plugin.seconds,
        "failed": sorted(plugin.failed),
        "names": names,
        "modules": {path: digest(tree / path) for path in lines},
        "lines": {
            path: {line: sorted(place[t] for t in tests if t in place) for line, tests in by_line.items() if tests}
            for path, by_line in lines.items()
        },
    }
    target = _place(tree, test_file, marker, cache)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.with_suffix(".part").write_text(json.dumps(content), encoding="utf-8")
    target.with_suffix(".part").replace(target)


def processor_s() -> float:
    """Processor time of this process and of its children that ended, s: a busy machine does not stretch it."""
    return sum(os.times()[:4])


def arguments(marker: str = "") -> list[str]:
    """Arguments of pytest for a run that leaves nothing behind."""
    without = ("cacheprovider", "xdist", "hypothesispytest", "unraisableexception")
    plain = ["-q", "--no-header", "--tb=line", *(f"-pno:{plugin}" for plugin in without)]
    return [*plain, "-m", marker] if marker else plain


def _place(tree: Path, test_file: str, marker: str, cache: Path) -> Path:
    own = [tree / test_file, tree / "tests" / "conftest.py", tree / "pyproject.toml", Path(__file__)]
    key = hashlib.sha256(" ".join([sys.version, marker, *(digest(path) for path in own)]).encode()).hexdigest()[:16]
    return cache / f"{Path(test_file).stem}-{key}.json"


def _subprocess_coverage(tree: Path, package: str, scratch: Path) -> coverage.Coverage:
    """Coverage of this process, and of the Python processes that the tests start, under the name of the test."""
    config = scratch / "coveragerc"
    config.write_text(
        f"[run]\nsource = {tree / package}\ndata_file = {scratch / '.coverage'}\nparallel = true\n"
        "context = ${PYTEST_CURRENT_TEST-}\npatch = _exit\n",
        encoding="utf-8",
    )
    os.environ["COVERAGE_PROCESS_START"] = str(config)
    return coverage.Coverage(
        data_file=str(scratch / ".coverage"), data_suffix="tests", source=[str(tree / package)], config_file=False
    )


class _Recorder:
    """Tells coverage which test runs; what a shared fixture executes belongs to all tests that use the fixture."""

    def __init__(self, cov: coverage.Coverage) -> None:
        self.coverage = cov
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self._users: dict[str, set[str]] = defaultdict(set)
        self._context = ""
        self._session: pytest.Session | None = None
        self._begun = processor_s()

    def tests_of(self, contexts: Iterable[str]) -> set[str]:
        tests: set[str] = set()
        for context in contexts:
            name = context.partition(" (")[0]  # PYTEST_CURRENT_TEST ends with " (call)"
            tests |= self._users.get(name, {name})
        return tests & set(self.seconds)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            for name in getattr(item, "fixturenames", ()):
                self._users[f"fixture {name}"].add(item.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._switch(item.nodeid)
        start = processor_s()
        done = yield
        if item.nodeid not in self.failed:
            self.seconds[item.nodeid] = round(processor_s() - start, 3)
        self._switch("")
        return done

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Generator[None, object, object]:
        before = self._context
        if fixturedef.scope != "function":
            self._switch(f"fixture {fixturedef.argname}")
        try:
            return (yield)
        finally:
            self._switch(before)

    def pytest_runtest_logfinish(self) -> None:
        if processor_s() - self._begun > LONGEST_S and self._session is not None:
            self._session.shouldstop = "the record of this file takes too long; later tests are not used"

    def pytest_sessionstart(self, session: pytest.Session) -> None:
        self._session = session

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)

    def _switch(self, context: str) -> None:
        self._context = context
        self.coverage.switch_context(context)
