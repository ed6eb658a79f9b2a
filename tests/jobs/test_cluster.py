"""The same jobs on a Ray cluster: the same files, also when a node is lost."""

import json
import threading

import pytest

from dynagen_bench.jobs import Job, run_jobs
from tests.jobs.test_local import chain, surely
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
    assert not list((tmp_path / "node0").glob("dynagen-jobs-*/.jobs/*/"))  # the nodes keep nothing of what is done


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
