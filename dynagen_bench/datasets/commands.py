"""What `dynagen data build|list|verify` do.

What is here: all datasets of a robot at once, with progress bars, held against the manifest. Called by the command
line. It must not know how episodes are made or stored.
"""

from collections.abc import Sequence
from pathlib import Path

import minari
import rich.box
import rich.console
import rich.progress
import rich.table

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, content_hash, dataset_folder, read_episodes, read_record
from dynagen_bench.collection.episodes import EPISODES_PER_SNAPSHOT
from dynagen_bench.collection.minari_files import build_dataset
from dynagen_bench.collection.policies import POLICY_FOLDER, load_policies, policy_file
from dynagen_bench.datasets.flat import checked_record
from dynagen_bench.datasets.manifest import RECORDS, ManifestEntry, add_to_manifest, check_official, read_manifest
from dynagen_bench.datasets.scores import REFERENCE_FILE, Reference, reference_scores, write_reference_scores


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
        policies_folder: where the stored behaviour policies are.
        episodes_per_snapshot: the official data have 50.
        records: the folder of the manifest and the reference scores.

    Raises:
        FileNotFoundError: a robot has no stored policies.
        ValueError: an unknown robot, or a dataset is not the official one.
    """
    names = [name for robot in robots for name in ids.dynamics_ids(robot)]
    for name in names:  # before the first of them is built
        load_policies(policy_file(name, policies_folder))
    manifest = {} if write_manifest else read_manifest(records)
    made: dict[ids.DynamicsId, DatasetRecord] = {}
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
                reference=_official_range(name, every, records),
                progress=lambda done, total, task=task: bars.update(task, completed=done, total=total),  # type: ignore[misc]
            )
            bars.remove_task(task)
            bars.advance(whole)
            if official:
                check_official(name.part_id(every), made[name], official)
    if write_manifest:
        _write_records(made, every, records)
    _show({name.part_id(every): record for name, record in made.items()}, records)


def list_datasets(records: Path = RECORDS) -> None:
    """Print a table of the benchmark's datasets on this machine.

    Their content is `official` (the manifest's), `differs` (another than the manifest's) or `unlisted` (not in it).
    """
    found = {name: read_record(dataset_folder(name)) for name in minari.list_local_datasets(prefix=ids.NAMESPACE)}
    if found:
        _show(found, records)
    else:
        place = dataset_folder(ids.NAMESPACE)
        rich.console.Console().print(
            f"no datasets in {place}: make them with `dynagen data build ROBOT`", soft_wrap=True
        )


def verify(robots: Sequence[str], *, every: int = 1, records: Path = RECORDS) -> None:
    """Read every dataset of the robots again and compare it with what it records and with the manifest.

    Raises:
        FileNotFoundError: a dataset is missing.
        ValueError: some datasets are damaged or not official; the message names them and says why.
    """
    names = [name for robot in robots for name in ids.dynamics_ids(robot)]
    found = {name.part_id(every): checked_record(name, every) for name in names}
    manifest = read_manifest(records)
    faults = []
    with _bars() as bars:
        for dataset_id, record in bars.track(list(found.items()), description="reading"):
            try:
                _check_content(dataset_id, record)
                if dataset_id in manifest:
                    check_official(dataset_id, record, manifest[dataset_id])
            except ValueError as fault:
                faults.append(str(fault))
    if faults:
        raise ValueError("; ".join(faults))
    _show(found, records)


def _check_content(dataset_id: str, record: DatasetRecord) -> None:
    try:
        intact = content_hash(read_episodes(dataset_folder(dataset_id))) == record.sha256
    except (OSError, KeyError) as error:  # h5py's own, for a cut file or a missing episode
        raise ValueError(f"{dataset_id} is damaged ({error}): build it again") from error
    if not intact:
        raise ValueError(f"{dataset_id} is damaged: its episodes are not those it records; build it again")


def _bars() -> rich.progress.Progress:
    columns = (*rich.progress.Progress.get_default_columns(), rich.progress.MofNCompleteColumn())
    return rich.progress.Progress(*columns, console=rich.console.Console(stderr=True))


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
    table.add_column("dataset", no_wrap=True)
    for column in ("steps", "min", "mean", "max"):
        table.add_column(column, justify="right", no_wrap=True, min_width=4)
    table.add_column("content", no_wrap=True, min_width=len("official"))
    for dataset_id, record in found.items():
        entry = manifest.get(dataset_id)
        content = "unlisted" if entry is None else "official" if entry.sha256 == record.sha256 else "differs"
        returns = [f"{record.returns[field]:.0f}" for field in ("min", "mean", "max")]
        table.add_row(dataset_id, f"{record.steps}", *returns, content)
    rich.console.Console().print(table)
