"""Jobs over processes that die, and over a cluster."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gfp_grasp.errors import InvalidOption, WorkerLost
from gfp_grasp.parallel import ATTEMPTS, pmap
from gfp_grasp.parallel import jobs as parallel_jobs

HAS_RAY = importlib.util.find_spec("ray") is not None


RUN = """
import sys, test_parallel
from gfp_grasp.parallel import pmap
list(pmap(test_parallel.signs_in_and_waits, [sys.argv[1]] * 2, workers=2))
"""


def signs_in_and_waits(folder: str) -> None:
    (Path(folder) / f"worker_{os.getpid()}").touch()
    time.sleep(300)


def _is_running(pid: int) -> bool:
    """A process that has ended and was not waited for, by an init that waits for none, has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _within_seconds(seconds: float, condition) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


def square(number: int) -> int:
    return number * number


def killed_once(job: tuple[int, str]) -> int:
    """Its process is killed the first time that it meets the number 3."""
    number, folder = job
    if number == 3 and not (Path(folder) / "was_here").exists():
        (Path(folder) / "was_here").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


def signs_in_and_is_killed(job: tuple[int, str]) -> int:
    number, folder = job
    if number == 3:
        (Path(folder) / f"died_{os.getpid()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


def always_killed(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


def refuses(number: int) -> int:
    if number == 3:
        raise InvalidOption("three is not expected")
    return square(number)


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs_and_are_kept_as_they_come(workers):
    kept, watched = [], []

    def watch(results, total):
        assert total == 5
        for result in results:
            watched.append(result)
            yield result

    jobs = range(3, 8)
    found = pmap(square, jobs, workers=workers, progress=watch, keep=lambda job, result: kept.append((job, result)))
    assert found == [9, 16, 25, 36, 49]
    assert sorted(watched) == found
    assert sorted(kept) == list(zip(jobs, found, strict=True))


def test_results_that_come_out_of_order_are_put_in_order(monkeypatch):
    def backwards(function, jobs, workers, lost):
        assert workers == os.cpu_count()
        return ((number, function(jobs[number])) for number in reversed(range(len(jobs))))

    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    monkeypatch.setattr(parallel_jobs, "over_processes", backwards)
    kept = []
    found = pmap(square, [2, 5, 3], workers=0, keep=lambda job, result: kept.append((job, result)))
    assert found == [4, 25, 9]
    assert kept == [(3, 9), (5, 25), (2, 4)]


def test_the_job_of_a_killed_worker_is_done_again(tmp_path):
    assert pmap(killed_once, [(i, str(tmp_path)) for i in range(8)], workers=2) == [i * i for i in range(8)]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc to see processes in")
def test_no_worker_outlives_an_owner_that_is_killed(tmp_path):
    owner = subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path)], cwd=Path(__file__).parent, stderr=subprocess.DEVNULL
    )
    assert _within_seconds(60, lambda: len(list(tmp_path.glob("worker_*"))) == 2)
    workers = [int(path.name.removeprefix("worker_")) for path in tmp_path.glob("worker_*")]
    assert all(map(_is_running, workers))
    owner.kill()
    owner.wait()
    assert _within_seconds(20, lambda: not any(map(_is_running, workers)))


def test_a_job_that_kills_every_worker_costs_no_other_its_result(tmp_path):
    kept = []
    with pytest.raises(WorkerLost, match=rf"{ATTEMPTS} processes died under 3"):
        pmap(always_killed, [3, *range(10, 14)], workers=2, keep=lambda job, _: kept.append(job))
    jobs = [(number, str(tmp_path)) for number in range(6)]
    found = pmap(signs_in_and_is_killed, jobs, workers=2, lost=lambda job, error: -job[0])
    assert found == [0, 1, 4, -3, 16, 25]
    assert len(list(tmp_path.glob("died_*"))) == 1 + ATTEMPTS  # once among others, then alone


@pytest.mark.parametrize("workers", [1, 2])
def test_a_jobs_own_error_is_seen_as_it_was(workers):
    with pytest.raises(InvalidOption, match="three is not expected"):
        pmap(refuses, range(5), workers=workers)


def test_a_negative_number_of_workers_is_refused():
    with pytest.raises(InvalidOption, match="workers is -1"):
        pmap(square, [1], workers=-1)


@pytest.mark.skipif(HAS_RAY, reason="Ray is installed")
def test_without_ray_the_extra_is_named():
    with pytest.raises(InvalidOption, match=r"gfp-grasp\[cluster\]"):
        pmap(square, [1, 2], ray="auto")


@pytest.fixture(scope="module")
def cluster():
    """Address of a cluster of two nodes of one core each, in processes of this machine."""
    utils = pytest.importorskip("ray.cluster_utils")
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # the nodes are to find the functions above
    made = utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    made.add_node(num_cpus=1)
    try:
        yield made.address
    finally:
        made.shutdown()
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before


@pytest.mark.slow
def test_a_cluster_gives_the_same_results_and_does_the_job_of_a_killed_worker_again(cluster, tmp_path):
    kept = []
    jobs = [(i, str(tmp_path)) for i in range(8)]
    found = pmap(killed_once, jobs, ray=cluster, keep=lambda job, _: kept.append(job))
    assert found == [i * i for i in range(8)]
    assert sorted(kept) == jobs
    assert (tmp_path / "was_here").exists()


@pytest.mark.slow
def test_on_a_cluster_too_a_bad_job_costs_no_other_its_result(cluster):
    assert pmap(always_killed, range(6), ray=cluster, lost=lambda job, error: -job) == [0, 1, 4, -3, 16, 25]
    with pytest.raises(InvalidOption, match="three is not expected"):
        pmap(refuses, range(5), ray=cluster)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_RAY, reason="Ray is not installed")
def test_a_cluster_that_is_not_there_is_named():
    with pytest.raises(InvalidOption, match="no Ray cluster"):
        pmap(square, [1, 2], ray="127.0.0.1:1")
