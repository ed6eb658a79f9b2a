"""The documents are true: README, CONTRIBUTING and docs.

Every block of Python and of the shell runs, on less data and for fewer steps. Blocks of text do not: what they show
takes a remote, a display, a cluster or hours.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from agents.sweep import read_lines
from agents.sweep_plan import plan

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

SMALLER = {
    "make ": f"make --directory {ROOT} --dry-run ",
    "dynagen data build Hopper": "dynagen data build Hopper --every 20",
    "--steps 5000": "--steps 2 --batch-size 4 --embedding 8",
    "agents.adapt runs/dadt-Hopper-seed0": "agents.adapt runs/dadt-Hopper-seed0 --steps 1",
    "STEPS = 5_000": "STEPS = 5",
    "steps=2_000,": "steps=4, batch_size=4, layers=1, embedding=8,",
    "evaluate_every=500": "evaluate_every=2, checkpoint_every=2, log_every=2",
    "AdaptationSettings(steps=200)": "AdaptationSettings(steps=1, episodes=2)",
}
"""What a test changes in a block before it runs it: its size and its place, not what it does."""


def blocks(document: Path, language: str) -> list[str]:
    """The code blocks of one language in a document, in order."""
    return [code for found, code in BLOCK.findall(document.read_text(encoding="utf-8")) if found == language]


def smaller(code: str) -> str:
    """A block as it is run here."""
    for full, small in SMALLER.items():
        code = code.replace(full, small)
    return code


def test_every_block_is_of_a_language_that_is_run():
    languages = {found for document in DOCUMENTS for found, _ in BLOCK.findall(document.read_text(encoding="utf-8"))}
    assert languages <= {"python", "bash", "text"}


@pytest.mark.usefixtures("tiny_data")
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_python_blocks_run(document, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for code in blocks(document, "python"):
        exec(compile(smaller(code), str(document), "exec"), namespace)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_shell_blocks_run(document, tmp_path, tiny_dataset_root):
    shutil.copytree(tiny_dataset_root, tmp_path / "data")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "MINARI_DATASETS_PATH": str(tmp_path / "data")}
    for code in blocks(document, "bash"):
        command = ["bash", "-euo", "pipefail", "-c", smaller(code)]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{code}\n{done.stdout}\n{done.stderr}"


def test_links_to_files_lead_somewhere():
    for document in DOCUMENTS:
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", document.read_text(encoding="utf-8")):
            assert (document.parent / target).exists(), f"{document.name} links to {target}"


def test_the_sweeps_of_the_repository_are_the_runs_that_the_page_counts():
    page = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")
    counted = {
        name: map(int, re.findall(r": (\d+)", runs)) for name, runs in re.findall(r"\| `(sweeps/.*)` \|(.*)\|", page)
    }
    planned = {
        str(path.relative_to(ROOT)): len(plan(read_lines(path))) for path in sorted((ROOT / "sweeps").glob("*.txt"))
    }
    assert {name: sum(counts) for name, counts in counted.items()} == planned
