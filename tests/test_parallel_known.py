"""Clusters without Ray, processes without dying, and threads: what is asked of each."""

import importlib.util
import logging
import os
import sys
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import threadpoolctl

from gfp_grasp.errors import InvalidOption, WorkerLost
from gfp_grasp.parallel import ATTEMPTS, jobs, one_thread, pmap, processes


class TaskError(Exception):
    """The job's own error, as Ray wraps it."""

    def as_instanceof_cause(self):
        return InvalidOption("three is not expected")


class NodeError(Exception):
    """A process that died once too often."""


class Ray:
    """A cluster that does jobs at once; 3 is an error of the job's own, 4 kills every process."""

    exceptions = SimpleNamespace(RayTaskError=TaskError, RayError=NodeError)

    def __init__(self, *, cpus: float | None = 2, running: bool = False, broken: Exception | None = None) -> None:
        self.cpus, self.running, self.broken = cpus, running, broken
        self.asked: list = []
        self.most, self.handed, self.cancelled, self.down = 0, 0, [], False

    def is_initialized(self):
        return self.running

    def init(self, **how):
        self.asked.append(("init", how))
        if self.broken is not None:
            raise self.broken

    def cluster_resources(self):
        return {} if self.cpus is None else {"CPU": self.cpus}

    def remote(self, **how):
        self.asked.append(("remote", how))
        return lambda function: SimpleNamespace(remote=lambda job: self.hand(function, job))

    def hand(self, function, job):
        self.handed += 1
        return function, job, self.handed

    def wait(self, references):
        self.most = max(self.most, len(references))
        return references[-1:], references[:-1]  # the last comes first

    def get(self, reference):
        function, job, _ = reference
        if job == 3:
            raise TaskError
        if job == 4:
            raise NodeError
        return function(job)

    def cancel(self, reference, *, force):
        self.cancelled.append((reference[1], force))

    def shutdown(self):
        self.down = True


@pytest.fixture
def cluster(monkeypatch):
    """Puts a cluster in the place of Ray, and notes at which doors was knocked."""

    def install(**how: Any) -> Ray:
        ray = Ray(**how)
        monkeypatch.setitem(sys.modules, "ray", ray)  # type: ignore[arg-type]
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: name == "ray" or None)
        return ray

    return install


def square(number: int) -> int:
    return number * number


def test_a_cluster_is_handed_a_few_jobs_for_each_core_and_gives_results_in_order(cluster):
    ray = cluster(cpus=2)
    kept, totals = [], []
    found = pmap(
        square,
        range(5, 30),
        ray="auto",
        keep=lambda job, result: kept.append((job, result)),
        progress=lambda stream, total: (totals.append(total), stream)[1],
    )
    assert found == [n * n for n in range(5, 30)]
    assert sorted(kept) == [(n, n * n) for n in range(5, 30)]
    assert kept[0] == (12, 144)  # the eighth job that was handed over, as this cluster begins with the last
    assert totals == [25]
    assert (ray.most, ray.handed, ray.cancelled, ray.down) == (8, 25, [], True)
    assert ray.asked == [
        ("init", {"address": "auto", "logging_level": logging.ERROR, "log_to_driver": False}),
        ("remote", {"max_retries": ATTEMPTS - 1, "num_cpus": 1}),
    ]


@pytest.mark.parametrize(("cpus", "room"), [(None, 4), (0.1, 1), (0.5, 2)])
def test_a_cluster_that_tells_no_cores_has_one(cluster, cpus, room):
    ray = cluster(cpus=cpus)
    assert pmap(square, range(5, 15), ray="auto") == [n * n for n in range(5, 15)]
    assert ray.most == room


def test_a_connection_that_was_there_before_is_used_and_left(cluster):
    ray = cluster(running=True)
    assert pmap(square, [1, 2], ray="somewhere:1") == [1, 4]
    assert [name for name, _ in ray.asked] == ["remote"]
    assert not ray.down


def test_a_jobs_own_error_ends_the_run_and_the_other_jobs(cluster):
    ray = cluster()
    with pytest.raises(InvalidOption, match="three is not expected"):
        pmap(square, [7, 8, 3], ray="auto")
    assert sorted(ray.cancelled) == [(7, True), (8, True)]
    assert ray.down


def test_a_job_that_no_node_survives_is_given_up_and_costs_no_other(cluster):
    ray = cluster()
    assert pmap(square, [7, 4, 8], ray="auto", lost=lambda job, error: -job) == [49, -4, 64]
    assert ray.cancelled == []
    with pytest.raises(WorkerLost, match=rf"{ATTEMPTS} processes died under 4"):
        pmap(square, [7, 4, 8], ray="auto")
    assert ATTEMPTS == 3


@pytest.mark.parametrize("error", [ConnectionError("no"), ValueError("no"), RuntimeError("no"), OSError("no")])
def test_a_cluster_that_is_not_there_is_named_and_how_to_start_one(cluster, error):
    cluster(broken=error)
    with pytest.raises(InvalidOption, match=r"no Ray cluster at 'auto' \(no\).*ray start --head"):
        pmap(square, [1, 2], ray="auto")


def test_ray_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InvalidOption, match=r"gfp-grasp\[cluster\]"):
        pmap(square, [1, 2], ray="auto")


@pytest.mark.parametrize(
    ("address", "place"), [("10.0.0.7:6379", ("10.0.0.7", 6379)), ("ray://head:10001", ("head", 10001))]
)
def test_an_address_is_knocked_at_for_five_seconds_before_ray_waits_for_minutes(cluster, monkeypatch, address, place):
    knocked, closed = [], []

    def connect(*where, **how):
        knocked.append((where, how))
        return SimpleNamespace(close=lambda: closed.append(True))

    monkeypatch.setattr(jobs.socket, "create_connection", connect)
    ray = cluster()
    assert pmap(square, [2], ray=address) == [4]
    assert knocked == [((place,), {"timeout": 5.0})]
    assert closed == [True]
    assert ray.asked[0][1]["address"] == address
    with pytest.raises(InvalidOption, match="no Ray cluster at 'head'"):
        pmap(square, [2], ray="head")
    pmap(square, [2], ray="auto")
    assert len(knocked) == 1


@pytest.mark.parametrize(("workers", "count"), [(0, 3), (2, 2), (4, 2)])
def test_several_jobs_run_in_several_processes(monkeypatch, workers, count):
    asked = []

    def over(function, all_jobs, processes, lost):
        asked.append((processes, lost))
        return ((number, function(job)) for number, job in enumerate(all_jobs))

    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    monkeypatch.setattr(jobs, "over_processes", over)
    lost: Any = object()
    assert pmap(square, range(count), workers=workers, lost=lost) == [n * n for n in range(count)]
    assert asked == [(workers or 3, lost)]
    assert pmap(square, [5], workers=workers) == [25]  # one job needs no process of its own
    assert len(asked) == 1
    assert pmap(square, range(3), workers=1) == [0, 1, 4]
    assert len(asked) == 1


def test_where_the_number_of_cores_is_unknown_one_process_is_used(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    monkeypatch.setattr(jobs, "over_processes", lambda *_: pytest.fail("one process is this one"))
    assert pmap(square, [2, 3], workers=0) == [4, 9]


class Pool:
    """Does jobs at once and dies at a job below zero, as it does at every one that was handed over after it."""

    made: list[Any]

    def __init__(self, size, **how: Any) -> None:
        self.size, self.how, self.dead, self.ended = size, how, False, None
        Pool.made.append(self)

    def submit(self, function, job):
        future: Future = Future()
        self.dead = self.dead or job < 0
        if self.dead:
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result(function(job))
        return future

    def shutdown(self, **how):
        self.ended = how


@pytest.fixture
def pools(monkeypatch) -> list[Any]:
    Pool.made = []
    monkeypatch.setattr(processes, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(processes, "as_completed", lambda futures: iter(list(futures)))
    monkeypatch.setattr(processes, "get_context", lambda way: f"context to {way}")
    return Pool.made


def test_processes_are_spawned_no_more_than_there_are_jobs_and_end_with_their_parent(pools):
    assert dict(processes.over_processes(square, range(3), 5, None)) == {0: 0, 1: 1, 2: 4}
    (pool,) = pools
    assert pool.size == 3
    assert pool.how == {"mp_context": "context to spawn", "initializer": processes._end_with_parent}
    assert pool.ended == {"wait": True, "cancel_futures": True}


def test_after_a_death_the_jobs_that_may_have_caused_it_run_alone(pools):
    """Two processes hold up to three jobs: numbers 2 to 4 are suspects, 5 and 6 go on in a new pool."""
    all_jobs = [1, 2, -3, 4, 5, 6, 7]
    found = dict(processes.over_processes(square, all_jobs, 2, lambda job, error: str(error)[:9]))
    assert found == {0: 1, 1: 4, 2: "3 process", 3: 16, 4: 25, 5: 36, 6: 49}
    assert [pool.size for pool in pools] == [2, 1, 1, 1, 1, 1, 2]  # the job that kills has three processes of its own
    with pytest.raises(WorkerLost, match="3 processes died under -3, killed or out of memory: try fewer workers"):
        list(processes.over_processes(square, all_jobs, 2, None))


def test_a_process_ends_when_its_parent_has_ended(monkeypatch):
    started, ended, joined = [], [], []

    class Thread:
        def __init__(self, **how):
            started.append(how)

        def start(self):
            started[-1]["target"]()

    monkeypatch.setattr(processes, "parent_process", lambda: SimpleNamespace(join=lambda: joined.append(True)))
    monkeypatch.setattr(processes.threading, "Thread", Thread)
    monkeypatch.setattr(os, "_exit", ended.append)
    processes._end_with_parent()
    (how,) = started
    assert (how["name"], how["daemon"], joined, ended) == ("end-with-parent", True, [True], [1])
    monkeypatch.setattr(processes, "parent_process", lambda: None)
    processes._end_with_parent()
    assert len(started) == 1


def test_linear_algebra_has_one_thread_within_and_its_own_number_after():
    np.linalg.svd(np.eye(3))
    with threadpoolctl.threadpool_limits(2):
        assert {pool["num_threads"] for pool in threadpoolctl.threadpool_info()} == {2}
        with one_thread():
            assert {pool["num_threads"] for pool in threadpoolctl.threadpool_info()} == {1}
        assert {pool["num_threads"] for pool in threadpoolctl.threadpool_info()} == {2}


def test_pools_are_looked_for_anew_when_one_more_library_is_loaded(monkeypatch):
    """Each of numpy, scipy, scikit-learn and torch brings a pool; to find them is slow, and is done once for each."""
    looked, limited = [], []

    class Controller:
        def __init__(self) -> None:
            looked.append(True)

        def limit(self, **how):
            limited.append(how)
            return threadpoolctl.threadpool_limits(None)

    loaded = SimpleNamespace(modules={})
    monkeypatch.setattr(processes, "ThreadpoolController", Controller)
    monkeypatch.setattr(processes, "sys", loaded)
    processes._pools.cache_clear()
    try:
        for number, name in enumerate(("numpy", "scipy.linalg", "sklearn", "torch"), start=1):
            loaded.modules[name] = None
            for _ in range(2):
                with one_thread():
                    assert len(looked) == number
        loaded.modules["scipy"] = loaded.modules["anything"] = None
        with one_thread():
            assert len(looked) == 4
        assert limited == [{"limits": 1}] * 9
        assert processes._pools.cache_parameters()["maxsize"] == 16
    finally:
        processes._pools.cache_clear()
