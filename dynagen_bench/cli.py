"""The `dynagen` command: one subcommand a thing one does with the benchmark.

What is here: the command line, read by tyro from these functions' signatures and docstrings, and what it prints.
Nothing calls it. It must not compute anything itself.
"""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import rich.table
import tyro

from dynagen_bench import __version__, ids
from dynagen_bench.collection.policies import POLICY_FOLDER
from dynagen_bench.collection.runs import collect as collect_runs
from dynagen_bench.collection.settings import changed_settings
from dynagen_bench.datasets import commands
from dynagen_bench.datasets.cards import write_data_card
from dynagen_bench.dynamics import PARAMETERS, draw_dynamics, factor_array, load_dynamics, nominal_robot
from dynagen_bench.envs.pages import write_page
from dynagen_bench.evaluation.baselines import Baseline, baseline_submission
from dynagen_bench.evaluation.submission import FILE_NAME, write_submission
from dynagen_bench.pictures import render_video, write_gallery, write_strip
from dynagen_bench.terminal import one_line_errors, print_table
from dynagen_bench.whole import check_writable

Robot = Annotated[str, tyro.conf.Positional]


def dynamics_show(robot: Robot, label: Annotated[str, tyro.conf.Positional]) -> None:
    """Print one dynamics as a table: each element's nominal value, factor and value, with units.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        label: train0 to train19, test0 to test4, or nominal.
    """
    name = ids.parse_label(ids.check_robot(robot), label)
    dynamics = load_dynamics(name.robot, name.split, name.index)
    nominal = nominal_robot(robot)
    table = rich.table.Table(
        "parameter", "element", "nominal", "factor", "value", "unit", title=f"{robot} {name.label}"
    )
    for column in table.columns[:5]:
        column.no_wrap = True  # names are there to be copied, and numbers to be read: units give way
    for column in table.columns[2:5]:
        column.justify = "right"
    for parameter in PARAMETERS:
        factors = factor_array(robot, dynamics, parameter)
        values = nominal.values[parameter.field]
        for i, element in enumerate(nominal.names[parameter.element]):
            if not np.any(values[i]):
                continue  # nothing to scale: the world's mass, a root joint's damping
            shown, scaled = (
                "\n".join(f"{v:.4g}" for v in np.atleast_1d(x)) for x in (values[i], values[i] * factors[i])
            )
            table.add_row(parameter.field, element, shown, f"{factors[i]:.3f}", scaled, parameter.unit)
        table.add_section()
    print_table(table)


def dynamics_draw(robot: Robot, seed: int, count: int = 1) -> None:
    """Draw new dynamics as the benchmark's own were drawn, and print them as JSON, one per line.

    Each line is what `gymnasium.make("Hopper-RandDyn-v0", dynamics=...)` takes.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        seed: the same seed draws the same dynamics.
        count: how many.
    """
    ids.check_robot(robot)
    ids.check_count("count", count)
    ids.check_count("seed", seed, least=0)
    for sequence in np.random.SeedSequence(seed).spawn(count):
        sys.stdout.write(json.dumps(draw_dynamics(robot, np.random.default_rng(sequence)).to_json()) + "\n")


def page(robot: Robot, output: Path | None = None) -> None:
    """Print the page of an environment, in Markdown: how it is made, its tables with units, what varies in it.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        output: write it to this file.
    """
    write_page(robot, output)


def render(
    robot: Robot,
    label: Annotated[str, tyro.conf.Positional],
    output: Path,
    policy: str = "best",
    policy_of: str | None = None,
    episodes: int = 1,
    seed: int = 0,
    speed: float = 1.0,
    width: int = 480,
    height: int = 480,
) -> None:
    """Write a video of a policy's episodes in one dynamics.

    Needs the [pictures] extra, and EGL or OSMesa where there is no display.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        label: train0 to train19, test0 to test4, or nominal.
        output: the file, .mp4 or .gif.
        policy: best (the snapshot that returns most where it acts without noise), a snapshot's steps as 1000000, random
            or zero.
        policy_of: act as the behaviour policies of this dynamics, in the body of the other.
        episodes: how many, one after the other.
        seed: the first episode's reset seed; the next one has the next number.
        speed: 1 is real time, 0.25 slow motion.
        width: of a frame, pixels.
        height: of a frame, pixels.
    """
    video = render_video(
        robot,
        label,
        output,
        policy=policy,
        policy_of=policy_of,
        episodes=episodes,
        seed=seed,
        speed=speed,
        width=width,
        height=height,
    )
    sys.stdout.write(f"{output}: {video}\n")


def gallery(
    output: Path,
    robots: Annotated[list[str], tyro.conf.Positional] = list(ids.ROBOTS),  # noqa: B006, never changed
) -> None:
    """Write one HTML page of all bodies: their factors, the same actions in several of them, their data's returns.

    Needs EGL or OSMesa where there is no display. The page loads nothing but itself.

    Args:
        output: the file.
        robots: Walker, Hopper, HalfCheetah, SlimHumanoid, Ant; none given means all.
    """
    write_gallery(output, robots)


def strip(robot: Robot, output: Path, size: int = 160) -> None:
    """Write one picture of the same actions in the nominal and the five test bodies: a column a body, a row a moment.

    Needs EGL or OSMesa where there is no display.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        output: the file, .png, .webp or .jpg.
        size: width and height of a frame, pixels.
    """
    write_strip(robot, output, size=size)


def collect(
    robot: Robot,
    labels: Annotated[list[str], tyro.conf.Positional] = [],  # noqa: B006, tyro reads the default and never changes it
    folder: Path = POLICY_FOLDER,
    processes: int | None = None,
    ray: str | None = None,
    change: Annotated[list[str], tyro.conf.UseAppendAction] = [],  # noqa: B006, as above
) -> None:
    """Train the SAC behaviour policies of a robot: what is missing is run, one pinned process a processor.

    Needs the [collect] extra. Hopper's 25 runs take about an hour on two processors. A run that dies is tried again;
    logs and records are in `.jobs` of the folder.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        labels: train0 to train19, test0 to test4; none given means all 25.
        folder: where the policies are kept.
        processes: how many at once; one per processor if not given.
        ray: run them on Ray: "local", or the address of a cluster, "auto" or HOST:PORT; needs the [cluster] extra.
        change: another setting of SAC for a trial, as `--change learning_rate=1e-3`; may be given again.
    """
    names = [ids.parse_label(robot, label) for label in dict.fromkeys(labels)] or list(ids.dynamics_ids(robot))
    collect_runs(names, changed_settings(robot, change), folder, processes, ray)
    sys.stdout.write(f"{len(names)} runs of {robot} are in {folder}\n")


def data_build(
    robots: Annotated[list[str], tyro.conf.Positional],
    every: int = 1,
    write_manifest: tyro.conf.FlagCreatePairsOff[bool] = False,
    folder: Path = POLICY_FOLDER,
) -> None:
    """Make the Minari datasets of robots from their stored behaviour policies, and check their content hashes.

    A build that was stopped continues; what is there and right is kept.

    Args:
        robots: one or more of Walker, Hopper, HalfCheetah, SlimHumanoid, Ant.
        every: take every n-th snapshot alone: a part of the data, under dataset ids of its own.
        write_manifest: for maintainers: write these hashes and reference scores as the official ones.
        folder: where the stored policies are. Data of others than the package's own are not official, and take the
            place of those that are: let MINARI_DATASETS_PATH name a folder for them.
    """
    commands.build(robots, every=every, write_manifest=write_manifest, policies_folder=folder)


def data_list() -> None:
    """Print the benchmark's datasets on this machine, and whether they are the official ones."""
    commands.list_datasets()


def data_verify(robots: Annotated[list[str], tyro.conf.Positional], every: int = 1) -> None:
    """Read every dataset of robots again and compare its content with the manifest.

    Args:
        robots: one or more of Walker, Hopper, HalfCheetah, SlimHumanoid, Ant.
        every: of the part that has every n-th snapshot alone.
    """
    commands.verify(robots, every=every)


def data_download(
    robots: Annotated[list[str], tyro.conf.Positional],
    labels: list[str] = [],  # noqa: B006, as in `collect`
    every: int = 1,
    remote: str | None = None,
) -> None:
    """Download the Minari datasets of robots that are not here, and check their content hashes.

    Needs the [remotes] extra. A download that was stopped continues; what is there and right is kept.

    Args:
        robots: one or more of Walker, Hopper, HalfCheetah, SlimHumanoid, Ant.
        labels: train0 to train19, test0 to test4; none given means all 25.
        every: of the part that has every n-th snapshot alone.
        remote: hf://NAME or gcp://BUCKET; MINARI_REMOTE if not given.
    """
    commands.download(robots, labels, every=every, remote=remote)


def data_publish(
    robots: Annotated[list[str], tyro.conf.Positional],
    labels: list[str] = [],  # noqa: B006, as in `collect`
    every: int = 1,
    output: Path | None = None,
    remote: str | None = None,
    unofficial: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> None:
    """Check the datasets of robots, then write them as a tree for any Minari remote, or upload them to one.

    Uploading needs the [remotes] extra. What was stopped continues; what is there already is not sent again.

    Args:
        robots: one or more of Walker, Hopper, HalfCheetah, SlimHumanoid, Ant.
        labels: train0 to train19, test0 to test4; none given means all 25.
        every: of the part that has every n-th snapshot alone.
        output: write a tree to this folder, beside what it has.
        remote: hf://NAME or gcp://BUCKET; MINARI_REMOTE if neither this nor an output is given.
        unofficial: publish data that are not the official ones, too.
    """
    commands.publish(robots, labels, every=every, output=output, remote=remote, unofficial=unofficial)


def data_card_page(robot: Robot, output: Path | None = None) -> None:
    """Print a page, in Markdown, of what is in the data of a robot, beside the paper's Table 5.

    Args:
        robot: Walker, Hopper, HalfCheetah, SlimHumanoid or Ant.
        output: write it to this file, and its two charts beside it.
    """
    write_data_card(robot, output)


def baseline(
    robots: Annotated[list[str], tyro.conf.Positional],
    output: Path,
    policy: Baseline = "random",
    runs: int = 5,
) -> None:
    """Evaluate a baseline in the test dynamics of robots, and write it as a submission with traces.

    Args:
        robots: one or more of Walker, Hopper, HalfCheetah, SlimHumanoid, Ant.
        output: the folder of the submission.
        policy: random, zero (no action at all), behaviour (what made the test dynamics' data), or expert (the best of
            those); zero and expert have one run.
        runs: seeds of each robot.
    """
    check_writable(output / FILE_NAME)  # before minutes of work that is to go there
    print(f"wrote {write_submission(output, *baseline_submission(policy, robots, runs))}")


COMMANDS: dict[str, Callable[..., None]] = {
    "dynamics show": dynamics_show,
    "dynamics draw": dynamics_draw,
    "page": page,
    "render": render,
    "gallery": gallery,
    "strip": strip,
    "collect": collect,
    "baseline": baseline,
    "data build": data_build,
    "data list": data_list,
    "data verify": data_verify,
    "data download": data_download,
    "data publish": data_publish,
    "data card": data_card_page,
}
"""What may follow `dynagen`: one word, or a group's word and one of its commands."""

ABOUT: Final = "DynaGen Bench: bodies, data and scores of offline dynamics generalization."


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command, or tell the version.

    A mistake of the user's ends in one line on stderr, and so does Ctrl-C.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        sys.stdout.write(f"dynagen-bench {__version__}\n")
        return
    word = given[0] if given else ""
    group = {name.removeprefix(f"{word} "): run for name, run in COMMANDS.items() if name.startswith(f"{word} ")}
    left = "`collect` and `data` continue when the same command is given again"
    with one_line_errors("dynagen", also=(RuntimeError,), stopped=left):
        tyro.extras.subcommand_cli_from_dict(
            group or COMMANDS,
            prog=f"dynagen {word}" if group else "dynagen",
            description=ABOUT if group else f"{ABOUT} --version tells which.",
            args=given[1:] if group else given,
        )


if __name__ == "__main__":
    main()
