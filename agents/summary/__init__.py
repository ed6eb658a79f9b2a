"""The page of many runs: learning curves with intervals over seeds, final results, configs and commands."""

from agents.summary.builder import write_summary

__all__ = ["write_summary"]
