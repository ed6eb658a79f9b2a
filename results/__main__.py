"""The command line: `python -m results keep RUN... --group reference`, `keep-compute`, `build`, `build --check`."""

from pathlib import Path
from typing import Annotated

import tyro

from dynagen_bench.terminal import one_line_errors
from dynagen_bench.whole import write_whole
from results.kept import REFERENCE, keep, keep_compute
from results.page import DRAWINGS, pages

DOCS = Path(__file__).parents[1] / "docs"


def _keep(
    runs: Annotated[list[Path], tyro.conf.Positional],
    group: str = REFERENCE,
    replace: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> None:
    """Keep what matters of finished runs: config, curves, next-state errors; no weights.

    Args:
        runs: their folders.
        group: what they belong to: `reference`, or what they vary.
        replace: Take the place of other runs of the same names.
    """
    for place in keep(runs, group, replace=replace):
        print(f"kept: {place}")


def _keep_compute(benchmark: Annotated[Path, tyro.conf.Positional]) -> None:
    """Keep the times of the compute comparison.

    Args:
        benchmark: what `python -m pytest tests/benchmarks/test_compute.py --benchmark-only --benchmark-json` wrote.
    """
    print(f"kept: {keep_compute(benchmark)}")


def _build(check: tyro.conf.FlagCreatePairsOff[bool] = False) -> None:
    """Make docs/results.md and its drawings from the board's entries and the kept runs.

    Args:
        check: Write nothing; end with status 1 if one of them is not what would be written.
    """
    made = pages()
    for path in sorted({*DOCS.glob(f"{DRAWINGS}/*.svg")} - {DOCS / name for name in made}):
        if check:
            raise ValueError(f"{path} is a drawing of nothing that is kept: run `python -m results build`")
        path.unlink()
        print(f"removed {path}")
    for name, text in made.items():
        path = DOCS / name
        if path.is_file() and path.read_bytes() == text.encode("utf-8"):
            continue
        if check:
            raise ValueError(f"{path} is stale: run `python -m results build`")
        write_whole(path, text)
        print(f"wrote {path}")


def main(arguments: list[str] | None = None) -> None:
    """Run one command; what is wrong is said in one line."""
    with one_line_errors():
        tyro.extras.subcommand_cli_from_dict(
            {"keep": _keep, "keep-compute": _keep_compute, "build": _build},
            prog="python -m results",
            description="The reference results: keep runs, and make docs/results.md.",
            args=arguments,
        )


if __name__ == "__main__":
    main()
