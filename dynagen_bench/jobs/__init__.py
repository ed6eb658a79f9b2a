"""Many independent, resumable jobs, on local processes or on a Ray cluster."""

from dynagen_bench.jobs.job import Job, Report
from dynagen_bench.jobs.records import changed_outputs
from dynagen_bench.jobs.runner import Outcome, run_jobs

__all__ = ["Job", "Outcome", "Report", "changed_outputs", "run_jobs"]
