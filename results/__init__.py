"""The reference results: runs that are kept, and the page that sets them beside the paper's.

What is here: `python -m results keep` puts what matters of finished runs into `results/runs`, `python -m results build`
makes docs/results.md from those and from the board's entries. It must not train, nor compute a score of its own.
"""
