"""What `dynagen data build|list|verify|download|publish` do.

What is here: all datasets of a robot at once, with progress bars, held against the manifest. Called by the command
line. It must not know how episodes are made or stored, nor how remotes are spoken to.
"""

import contextlib
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import minari
import rich.box
import rich.console
import rich.progress
import rich.table

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, dataset_folder, read_record
from dynagen_bench.collection.episodes import EPISODES_PER_SNAPSHOT
from dynagen_bench.collection.minari_files import build_dataset
from dynagen_bench.collection.policies import POLICY_FOLDER, load_policies, policy_file
from dynagen_bench.datasets.checks import check_dataset, check_mujoco
from dynagen_bench.datasets.downloads import arrival_folder, download_dataset, download_namespaces
from dynagen_bench.datasets.flat import checked_record
from dynagen_bench.datasets.manifest import (
    RECORDS,
    ManifestEntry,
    add_to_manifest,
    check_official,
    read_manifest,
    standing,
)
from dynagen_bench.datasets.publishing import add_to_tree, send_dataset, send_namespaces
from dynagen_bench.datasets.remotes import connect, namespace_of
from dynagen_bench.datasets.scores import REFERENCE_FILE, Reference, reference_scores, write_reference_scores
from dynagen_bench.terminal import print_table


def build(
    robots: Sequence[str],
    *,
    every: int = 1,
    write_manifest: bool = False,
    policies_folder: Path = POLICY_FOLDER,
    episodes_per_snapshot: int = EPISODES_PER_SNAPSHOT,
    records: Path = RECORDS,
) -> None:
    """Make the 25 Minari datasets of each robot, check them against the manifest, and print a table of them.

    What is there already and right is kept; a build that was stopped continues with the dataset it was at.

    Args:
        robots: names of robots.
        every: take every n-th snapshot alone; a part has dataset ids of its own.
        write_manifest: for maintainers: instead of checking, write these hashes (and, from whole data, the reference
            scores) as the official ones.
        policies_folder: where the stored behaviour policies are. Of others than the package's own nothing official is
            expected: their data take the place of what there is under the same ids.
        episodes_per_snapshot: the official data have 50.
        records: the folder of the manifest and the reference scores.

    Raises:
        FileNotFoundError: a robot has no stored policies.
        ValueError: an unknown robot or none, other policies for the manifest, or a dataset is not the official one; all
            have been made then.
    """
    names = _chosen(robots, ())
    for name in names:  # before the first of them is built
        load_policies(policy_file(name, policies_folder))
    foreign = records == RECORDS and policies_folder.resolve() != POLICY_FOLDER.resolve()
    if foreign and write_manifest:
        raise ValueError(
            f"{policies_folder} has not the package's own policies: their data cannot be the official ones"
        )
    manifest = {} if write_manifest or foreign else read_manifest(records)
    made: dict[ids.DynamicsId, DatasetRecord] = {}
    faults: list[str] = []
    with _bars() as bars:
        whole = bars.add_task("datasets", total=len(names))
        for name in names:
            official = manifest.get(name.part_id(every))
            task = bars.add_task(name.part_id(every), total=None)
            made[name] = build_dataset(
                name,
                policies_folder=policies_folder,
                episodes_per_snapshot=episodes_per_snapshot,
                every=every,
                expected_sha256=official.sha256 if official else None,
                reference=None if foreign else _official_range(name, every, records),
                progress=lambda done, total, task=task: bars.update(task, completed=done, total=total),  # type: ignore[misc]
            )
            bars.remove_task(task)
            bars.advance(whole)
            if official:
                try:
                    check_official(name.part_id(every), made[name], official)
                except ValueError as fault:  # the others are made all the same: they are data, if not official ones
                    faults.append(str(fault))
    if write_manifest:
        _write_records(made, every, records)
    elif foreign:
        _say(f"made from the policies in {policies_folder}, and not held against the manifest: `differs` is no fault")
    _show({name.part_id(every): record for name, record in made.items()}, records)
    if faults:
        raise ValueError(
            f"{faults[0]}. {len(faults)} of {len(names)} datasets differ; official ones come by `dynagen data download`"
        )


def list_datasets(records: Path = RECORDS) -> None:
    """Print a table of the benchmark's datasets on this machine.

    Their content is `official` (the manifest's), `differs` (another than the manifest's) or `unlisted` (not in it).
    """
    found = {}
    for dataset_id in minari.list_local_datasets(prefix=ids.NAMESPACE):
        try:
            found[dataset_id] = read_record(dataset_folder(dataset_id))
        except ValueError:
            _say(f"{dataset_id} is none of this benchmark's datasets, or damaged")
    if found:
        _show(found, records)
    else:
        place = dataset_folder(ids.NAMESPACE)
        rich.console.Console().print(
            f"no datasets in {place}: make them with `dynagen data build ROBOT`", soft_wrap=True
        )


def verify(robots: Sequence[str], *, every: int = 1, records: Path = RECORDS) -> None:
    """Read every dataset of the robots again and compare it with what it records, the manifest and MuJoCo here.

    Raises:
        FileNotFoundError: a dataset is missing.
        ValueError: no robot is given, or some datasets are damaged, not official or of another MuJoCo; the message
            names each and says why.
    """
    names = _chosen(robots, ())
    if missing := [name for name in names if not dataset_folder(name.part_id(every)).is_dir()]:
        checked_record(missing[0], every)  # says which command makes it, before the others are read
    manifest = read_manifest(records)
    found: dict[str, DatasetRecord] = {}
    faults = []
    with _bars() as bars:
        for name in bars.track(names, description="reading"):
            dataset_id = name.part_id(every)
            try:
                check_mujoco(dataset_id, checked_record(name, every))
                found[dataset_id] = check_dataset(dataset_folder(dataset_id), name, every, manifest.get(dataset_id))
            except ValueError as fault:
                faults.append(str(fault))
    if faults:
        raise ValueError("; ".join(faults) + ". What is damaged can be built or downloaded again")
    _show(found, records)


def download(
    robots: Sequence[str],
    labels: Sequence[str] = (),
    *,
    every: int = 1,
    remote: str | None = None,
    records: Path = RECORDS,
) -> None:
    """Download the datasets of robots that are not here, check every one, and print a table of all.

    What is there already and right is kept; a download that was stopped continues with the dataset it was at.

    Args:
        robots: names of robots.
        labels: `train0` ... `test4`; none means all 25.
        every: the part of the data that has every n-th snapshot alone.
        remote: `hf://NAME` or `gcp://BUCKET`; None takes `MINARI_REMOTE`.
        records: the folder of the manifest.

    Raises:
        ValueError: an unknown robot, label or remote, or the remote has not the right data; all before it are here.
        RuntimeError: the remote does not answer, or the [remotes] extra is not installed.
    """
    names = _chosen(robots, labels)
    manifest = read_manifest(records)
    source = connect(remote)
    found: dict[str, DatasetRecord] = {}
    with _bars() as bars:
        whole = bars.add_task("datasets", total=len(names))
        for name in names:
            dataset_id = name.part_id(every)
            task = bars.add_task(f"{dataset_id}, MB", total=None, arrival=arrival_folder(dataset_id))
            found[dataset_id] = download_dataset(
                source,
                name,
                every,
                manifest.get(dataset_id),
                started=lambda size, task=task: bars.update(task, total=size / 1e6),  # type: ignore[misc]
            )
            bars.remove_task(task)
            bars.advance(whole)
        download_namespaces(source, [ids.NAMESPACE, *_namespaces(found)])
    if unlisted := [dataset_id for dataset_id in found if dataset_id not in manifest]:
        _say(f"not in the manifest, and checked against what they record alone: {', '.join(unlisted)}")
    _show(found, records)


def publish(
    robots: Sequence[str],
    labels: Sequence[str] = (),
    *,
    every: int = 1,
    output: Path | None = None,
    remote: str | None = None,
    unofficial: bool = False,
    records: Path = RECORDS,
) -> None:
    """Check the datasets of robots, then write them as a tree for any remote, or upload them to one.

    What the tree or the remote has already is kept, and what was stopped continues when it is done again.

    Args:
        robots: names of robots.
        labels: `train0` ... `test4`; none means all 25.
        every: the part of the data that has every n-th snapshot alone.
        output: the folder of the tree.
        remote: `hf://NAME` or `gcp://BUCKET`; None takes `MINARI_REMOTE` if there is no `output`.
        unofficial: publish data that are not the official ones, too.
        records: the folder of the manifest.

    Raises:
        FileNotFoundError: a dataset is missing.
        ValueError: an unknown robot, label or remote, a damaged dataset, one that is not official, or other data there.
        RuntimeError: the remote does not answer, or the [remotes] extra is not installed.
    """
    if output is not None and remote is not None:
        raise ValueError(f"both --output {output} and --remote {remote} are given: publish to one after the other")
    names = _chosen(robots, labels)
    if output is not None and not (output := output.resolve()).is_dir() and output.exists():
        raise ValueError(f"{output} is no folder: give --output the path of one, or of none yet")
    target = connect(remote) if output is None else None
    found, manifest = _publishable(names, every, unofficial, records), read_manifest(records)
    official = {key for key, record in found.items() if standing(record, manifest.get(key)) == "official"}
    if target is None:
        assert output is not None
        with _bars() as bars:
            task = bars.add_task("writing", total=len(found))
            add_to_tree(output, found, official, lambda: bars.advance(task))
        _say(f"{len(found)} datasets are in {output}")
        return
    sent = 0
    with _bars() as bars:
        whole = bars.add_task("datasets", total=len(found))
        send_namespaces(target, _namespaces(found))
        for dataset_id, record in found.items():
            bars.update(whole, description=f"uploading {dataset_id}")
            sent += send_dataset(target, dataset_id, record, replace=dataset_id in official)
            bars.advance(whole)
    _say(f"{sent} datasets were sent to {target.address}, {len(found) - sent} were there")


def _publishable(
    names: Sequence[ids.DynamicsId], every: int, unofficial: bool, records: Path
) -> dict[str, DatasetRecord]:
    """The records of datasets that may be published: each is whole, and the official one unless that is waived."""
    for name in names:  # before the first of them is read
        checked_record(name, every)
    manifest = read_manifest(records)
    found: dict[str, DatasetRecord] = {}
    with _bars() as bars:
        for name in bars.track(names, description="reading"):
            dataset_id = name.part_id(every)
            official = manifest.get(dataset_id)
            if official is None and not unofficial:
                raise ValueError(
                    f"{dataset_id} is not in the manifest: only official data are published, or any with --unofficial"
                )
            found[dataset_id] = check_dataset(dataset_folder(dataset_id), name, every, None if unofficial else official)
    return found


def _chosen(robots: Sequence[str], labels: Sequence[str]) -> list[ids.DynamicsId]:
    """Some dynamics of each robot; no label means all that have data, but no robot is a mistake."""
    if not robots:
        raise ValueError(f"no robot is given: name one or more of {', '.join(ids.ROBOTS)}")
    names = [
        name
        for robot in robots
        for name in ([ids.parse_label(ids.check_robot(robot), label) for label in labels] or ids.dynamics_ids(robot))
    ]
    if any(name.split == "nominal" for name in names):
        raise ValueError("there are no data of the nominal robots: write train0 to train19, test0 to test4")
    return list(dict.fromkeys(names))


def _namespaces(dataset_ids: Iterable[str]) -> list[str]:
    return sorted({namespace_of(dataset_id) for dataset_id in dataset_ids})


def _say(text: str) -> None:
    rich.console.Console(stderr=True).print(text, soft_wrap=True, highlight=False)


class _Bars(rich.progress.Progress):
    """Progress bars; one with a field `arrival` shows the megabytes that are in that folder."""

    def get_renderables(self) -> Iterable[rich.console.RenderableType]:
        for task in self.tasks:
            if "arrival" in task.fields:
                with contextlib.suppress(KeyError):  # this runs beside the download, which may just have ended
                    self.update(task.id, completed=_megabytes(task.fields["arrival"]))
        yield from super().get_renderables()


def _megabytes(folder: Path) -> float:
    size = 0
    for place, _, files in os.walk(folder):  # which passes over folders that go away meanwhile
        for file in files:
            with contextlib.suppress(FileNotFoundError):
                size += Path(place, file).stat().st_size
    return size / 1e6


def _bars() -> rich.progress.Progress:
    columns = (*rich.progress.Progress.get_default_columns(), rich.progress.MofNCompleteColumn())
    return _Bars(*columns, console=rich.console.Console(file=sys.stderr))


def _reference_file(records: Path) -> Path:
    return records / REFERENCE_FILE.name


def _official_range(name: ids.DynamicsId, every: int, records: Path) -> tuple[float, float] | None:
    """Min and max return of a dynamics' whole data, for its part; the whole brings its own."""
    if every == 1:
        return None
    try:
        scores = reference_scores(name.robot, _reference_file(records))
    except ValueError:
        return None  # none yet: the part's own have to do
    return scores[name.label].min, scores[name.label].max


def _write_records(made: dict[ids.DynamicsId, DatasetRecord], every: int, records: Path) -> None:
    add_to_manifest({name.part_id(every): ManifestEntry.of(record) for name, record in made.items()}, records)
    if every != 1:
        return  # reference scores are of the whole data
    for robot in dict.fromkeys(name.robot for name in made):
        scores = {name.label: Reference(**record.returns) for name, record in made.items() if name.robot == robot}
        write_reference_scores(robot, scores, _reference_file(records))


def _show(found: dict[str, DatasetRecord], records: Path) -> None:
    manifest = read_manifest(records)
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("dataset", overflow="fold")  # where there is no room for an id it goes on below; numbers do not
    for column in ("steps", "min", "mean", "max"):
        table.add_column(column, justify="right", no_wrap=True, min_width=7 if column == "steps" else 5)
    table.add_column("content", no_wrap=True, min_width=len("official") + 1)
    for dataset_id, record in found.items():
        returns = [f"{record.returns[field]:.0f}" for field in ("min", "mean", "max")]
        table.add_row(dataset_id, f"{record.steps}", *returns, standing(record, manifest.get(dataset_id)))
    print_table(table)
