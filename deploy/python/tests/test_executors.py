"""Sweeps whose parts an executor takes: the rows are those of one process."""

from __future__ import annotations

import os
import subprocess
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import pytest

import metamorph as mm

SWARM = "swarm"
VARY = {"link.loss": ["0%", "5%"]}
REPOSITORY = Path(__file__).resolve().parents[3]


def required(name: str) -> bool:
    """Whether `METAMORPH_REQUIRE` says that a check must not be skipped."""
    return name in os.environ.get("METAMORPH_REQUIRE", "").replace(",", " ").split()


def lines(sweep: mm.Sweep, directory: Path) -> str:
    sweep.save(directory)
    return (directory / "manifest.json").read_text() + (directory / "runs.csv").read_text()


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return lines(mm.sweep(SWARM, seeds=range(3, 14), vary=VARY), tmp_path_factory.mktemp("whole") / "out")


def check(executor, expected, tmp_path):
    done = []
    swept = mm.sweep(SWARM, seeds=range(3, 14), vary=VARY, executor=executor, jobs=2, progress=done.append)
    assert lines(swept, tmp_path / "out") == expected
    assert done[-1] == (22, 22) and [p.done for p in done] == sorted(p.done for p in done)


def test_threads_and_processes(expected, tmp_path):
    with ThreadPoolExecutor(2) as threads:
        check(threads, expected, tmp_path / "threads")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        check(processes, expected, tmp_path / "processes")


class Jobs:
    """An executor as that of submitit: its jobs exist when the batch ends, and are no futures."""

    def __init__(self) -> None:
        self.begun, self.jobs = False, []

    @contextmanager
    def batch(self):
        yield
        self.begun = True

    def submit(self, call, *args):
        executor = self

        class Job:
            asked, is_cancelled = 0, False

            def done(self) -> bool:
                assert executor.begun
                self.asked += 1
                return self.asked > 1

            def result(self):
                assert executor.begun
                return call(*args)

            def cancel(self) -> None:
                self.is_cancelled = True

        self.jobs.append(Job())
        return self.jobs[-1]


def test_jobs_that_are_no_futures(expected, tmp_path):
    check(Jobs(), expected, tmp_path)


def test_what_has_not_begun_is_cancelled(tmp_path):
    jobs = Jobs()

    def interrupt(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mm.sweep(SWARM, seeds=range(8), executor=jobs, jobs=2, progress=interrupt)
    assert len(jobs.jobs) == 8 and all(job.is_cancelled for job in jobs.jobs)


def test_errors_of_a_part_are_those_of_the_sweep():
    with ThreadPoolExecutor(1) as executor, pytest.raises(mm.SweepError, match="105%"):
        mm.sweep(SWARM, seeds=range(2), set={"link.loss": "105%"}, executor=executor)


def test_dask(expected, tmp_path):
    if not required("dask"):
        pytest.importorskip("distributed")
    from distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        check(client.get_executor(), expected, tmp_path)


def test_submitit(expected, tmp_path):
    if not required("slurm"):
        pytest.skip("METAMORPH_REQUIRE=slurm starts a SLURM on this machine; it needs root, slurm-wlm, munge and submitit")
    import submitit

    lab = [str(REPOSITORY / "deploy/cluster/lab-slurm")]
    begun = subprocess.run([*lab, "start", tmp_path / "lab"], check=True, capture_output=True, text=True)
    os.environ["SLURM_CONF"] = begun.stdout.split("=", 1)[1].strip()
    try:
        executor = submitit.AutoExecutor(folder=tmp_path / "jobs")
        executor.update_parameters(timeout_min=10, slurm_partition="low")
        check(executor, expected, tmp_path)
    finally:
        subprocess.run([*lab, "stop", tmp_path / "lab"], check=True)
        del os.environ["SLURM_CONF"]
