"""The same jobs on a Ray cluster: the same files, also when a node is lost."""

import json
import shutil
import signal
import threading

import pytest

from dynagen_bench.jobs import Job, changed_outputs, run_jobs
from tests.jobs.test_local import chain, runner, surely
from tests.jobs.work import journal_lines

pytestmark = pytest.mark.slow  # Ray takes seconds to start and to end


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A cluster of two nodes of one processor each, whose temporary folders are their own."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    nodes = []
    for i in range(2):
        (tmp_path / f"node{i}").mkdir()
        nodes.append({"num_cpus": 1, "env_vars": {"TMPDIR": str(tmp_path / f"node{i}")}})
    cluster = Cluster(initialize_head=True, head_node_args={**nodes[0], "include_dashboard": False})
    cluster.add_node(**nodes[1])
    yield cluster
    cluster.shutdown()


def test_a_node_is_lost_and_no_job_is(cluster, tmp_path):
    journal = tmp_path / "journal"
    jobs = [chain(journal, f"job{i}", 10, 0.2) for i in range(4)]
    jobs.append(Job("killed", "tests.jobs.work:killed_once", {}, ("out.txt",), 1))
    lost = next(iter(cluster.worker_nodes))

    def lose_a_node():
        surely(lambda: len(journal_lines(journal)) >= 2)  # one on each node
        cluster.remove_node(lost, allow_graceful=False)

    thread = threading.Thread(target=lose_a_node)
    thread.start()
    outcomes = run_jobs(jobs, tmp_path / "cluster", ray=cluster.address)
    thread.join()
    assert sum(outcome.attempts for outcome in outcomes[:4]) == 5
    assert (tmp_path / "cluster" / "out.txt").read_text() == "whole"
    records = [json.loads(path.read_text()) for path in (tmp_path / "cluster" / ".jobs").glob("*.json")]
    assert {record["executor"] for record in records} == {"ray"}

    here = run_jobs([*(chain(journal, f"job{i}", 10) for i in range(4)), jobs[4]], tmp_path / "local")
    assert [outcome.sha256 for outcome in here] == [outcome.sha256 for outcome in outcomes]
    assert not list((tmp_path / "node0").glob("dynagen-jobs-*/*/.jobs/*/"))  # the nodes keep nothing of what is done


def test_what_a_job_made_outlives_its_runner_but_not_its_folder_of_results(cluster, tmp_path):
    cluster.remove_node(next(iter(cluster.worker_nodes)))  # else another node may get it next time
    folder, what = tmp_path / "results", {"count": 1, "steps": 5, "seconds": 0.3, "ray": cluster.address}
    job, journal = chain(folder / "journal", "job0", 5, 0.3), folder / "journal"

    def lines(word):
        return [line for line in journal_lines(journal) if line[0] == word]

    with runner(folder, **what) as process:
        surely(lambda: lines("start"))
        process.send_signal(signal.SIGSTOP)  # it takes nothing more, and is killed then
        surely(lambda: list((tmp_path / "node0").glob("dynagen-jobs-*/*/.jobs/*.json")))
    (outcome,) = run_jobs([job], folder, ray=cluster.address)
    assert len(lines("start")) == len(lines("end")) == 1
    assert not changed_outputs(job, folder)
    assert not [path for path in (tmp_path / "node0").glob("dynagen-jobs-*/**/*") if path.suffix in (".bin", ".json")]

    shutil.rmtree(folder)
    with runner(folder, **what):
        surely(lambda: list((tmp_path / "node0").glob("dynagen-jobs-*/*/.jobs/*/checkpoint.json")))
    shutil.rmtree(folder)  # a new folder in its place is another one, and nothing in it has been begun
    assert run_jobs([job], folder, ray=cluster.address)[0].sha256 == outcome.sha256
    assert [len(lines(word)) for word in ("start", "continue", "end")] == [1, 0, 1]


def test_rays_failures_are_one_line(tmp_path, monkeypatch):
    broken = Job("broken", "tests.jobs.work:broken", {}, ("broken.txt",), 1)
    with pytest.raises(RuntimeError, match=r"1 of 1 jobs failed.*broken: exit code 1 \(ValueError: the worst\)"):
        run_jobs([broken], tmp_path, ray="local")
    for address in ("nowhere", "ray://nowhere", "127.0.0.1:1"):
        with pytest.raises(
            RuntimeError, match=rf"no Ray cluster at '{address}' \(.*\): give 'local', 'auto' or the HOST"
        ):
            run_jobs([broken], tmp_path, ray=address)
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)
    with pytest.raises(RuntimeError, match=r"pip install 'dynagen-bench\[cluster\]'"):
        run_jobs([broken], tmp_path, ray="local")
