"""A page per environment: what it is, how it is made, what of it varies and how that was drawn.

What is here: `environment_page`, Markdown written from the docstrings of the robots, of `Rules` and of the draws, and
from the draws themselves. Called by `dynagen page`. It must not know data, agents or scores.
"""

import ast
import enum
import inspect
import itertools
import math
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import Parameter, draws, factor_array, load_dynamics, nominal_robot
from dynagen_bench.envs.robots import ROBOT_CLASSES
from dynagen_bench.envs.rules import Rules, keyword_fields
from dynagen_bench.envs.single import RENDER_KEYWORDS, RandomDynamics
from dynagen_bench.envs.vector import RandomDynamicsVector
from dynagen_bench.markdown import table
from dynagen_bench.whole import write_whole

HEADINGS: Final = {
    "Actions": "Actions",
    "Observations": "Observations",
    "Reward": "Reward",
    "The episode": "Termination",
    "Start": "Start",
    "Beside Gymnasium": "Differences from Gymnasium",
}
"""How a paragraph of a robot's docstring begins → the heading it opens on its page."""

INFO: Final = {
    "x_position": "position of the root along x, m",
    "y_position": "position of the root along y, m",
    "z_distance_from_origin": "height of the root above the reference pose, m",
    "distance_from_origin": "distance of the root from the origin along the ground, m",
    "tendon_length": "lengths of the hip-knee tendons, (2,)",
    "tendon_velocity": "velocities of the hip-knee tendons, (2,)",
    "dynamics_index": "index of the dynamics in its split, drawn or given; −1 with `dynamics=`",
    "x_velocity": "v, displacement of the root along x over the step's duration, m/s",
    "y_velocity": "displacement of the root along y over the step's duration, m/s",
    "reward_forward": "term of the reward for v",
    "reward_survive": "term of the reward for a healthy state",
    "reward_ctrl": "term of the reward for the action, not above 0",
    "reward_contact": "term of the reward for contact forces, not above 0",
}
"""Keys of `info` and their meanings; which of them a robot has is asked of its environment."""

NUMBERS: Final = {
    "body_inertia": " An element has three numbers, of its principal axes.",
    "geom_friction": " An element has three numbers: sliding (1), torsional (m), rolling (m).",
}
"""What to say of the parameters that have more than one number an element."""


def environment_page(robot: str) -> str:
    """The page of a robot, Markdown; the same text wherever it is written.

    Raises:
        ValueError: an unknown robot.
    """
    robot_class = ROBOT_CLASSES[ids.check_robot(robot)]
    introduction, *sections = _docstring_sections(robot_class)
    blocks = [
        f"# {robot}",
        introduction,
        f"This page is made by `dynagen page {robot}` from the docstrings of the code and from the draws.",
        *_usage(robot),
        *sections,
        _common_differences(robot),
        *_info(robot),
        *_keywords(robot_class),
        *_many(robot),
        *_variation(robot),
        *_drawing(robot),
        *_test_factors(robot),
    ]
    return "\n\n".join(blocks) + "\n"


def write_page(robot: str, output: Path | None = None) -> None:
    """Print the page of a robot, or write it to a file; raises ValueError for an unknown robot."""
    page = environment_page(robot)
    if output is None:
        sys.stdout.write(page)
        return
    write_whole(output, page)


def attribute_docs(owner: type | ModuleType) -> dict[str, str]:
    """The strings under the attributes of a class or module, by attribute, each on one line."""
    body = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
    if isinstance(owner, type):
        assert isinstance(body[0], ast.ClassDef), "the source of a class is a class"
        body = body[0].body
    docs = {}
    for statement, following in itertools.pairwise(body):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                docs[name] = " ".join(text.split())
    return docs


def _docstring_sections(robot_class: type[RandomDynamics]) -> list[str]:
    """The paragraphs of a robot's docstring, with a heading before those that open a section; the first has none."""
    sections: list[list[str]] = [[]]
    for paragraph in inspect.cleandoc(robot_class.__doc__ or "").split("\n\n"):
        heading = next((name for words, name in HEADINGS.items() if paragraph.startswith(words)), None)
        if heading is not None:
            sections.append([f"## {heading}"])
        sections[-1].append(paragraph)
    return ["\n\n".join(section) for section in sections]


def _usage(robot: str) -> list[str]:
    nominal = nominal_robot(robot).names
    body, geom = nominal["body"][1], nominal["geom"][0]
    sizes = ids.SPLIT_SIZES
    return [
        "## Make it",
        _prose(
            f"`{ids.v0_env_id(robot)}` takes the keywords below; `{robot}-RandDyn-train0` to "
            f"`train{sizes['train'] - 1}` and `{robot}-RandDyn-test0` to `test{sizes['test'] - 1}` are the same "
            "environment with one dynamics each."
        ),
        f"""```python
import gymnasium
import dynagen_bench

env = gymnasium.make("{robot}-RandDyn-test3")
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

nominal = gymnasium.make("{ids.v0_env_id(robot)}", split="nominal")  # every factor is 1
any_of_twenty = gymnasium.make("{ids.v0_env_id(robot)}", split="train")  # draws one of them at every reset
factors = {{"body_mass": {{"{body}": 1.5}}, "geom_friction": {{"{geom}": 0.5}}}}
my_own = gymnasium.make("{ids.v0_env_id(robot)}", dynamics=factors)
five = gymnasium.make_vec("{ids.v0_env_id(robot)}", num_envs=5, split="test")  # one of each test dynamics
```""",
    ]


def _common_differences(robot: str) -> str:
    horizon = gymnasium.spec(ids.v0_env_id(robot)).max_episode_steps
    return "\n".join(
        [
            "For every robot of the benchmark:",
            "",
            f"- An episode is truncated after {horizon} steps, Gymnasium's after 1000.",
            '- Mass, inertia, damping and friction are drawn, as below; `split="nominal"` leaves them as they are.',
            "- The solver's warm start is cleared before each step: a step is a function of (dynamics, qpos, qvel,",
            "  action) and of nothing else, bit for bit.",
            "- The action is clipped to its range before its cost is taken; Gymnasium takes it as it was given.",
            "- An action of another shape, or one that is not finite, raises ValueError.",
            "- A step in which MuJoCo reports a bad state ends the episode: the old state, reward 0, and",
            '  `info["unstable"]` is True.',
        ]
    )


def _info(robot: str) -> list[str]:
    env = gymnasium.make(ids.make_id(robot, "test", 0).env_id)
    _, at_reset = env.reset(seed=0)
    at_step = env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))[4]
    env.close()
    rows = [
        [f"`{key}`", *("yes" if key in given else "" for given in (at_reset, at_step)), INFO[key]]
        for key in sorted(at_reset | at_step, key=list(INFO).index)
    ]
    return ["## Info", table(["key", "reset", "step", "meaning"], rows, numbers_from=None)]


def _keywords(robot_class: type[RandomDynamics]) -> list[str]:
    docs, theirs = attribute_docs(Rules), inspect.signature(robot_class.__bases__[1]).parameters
    rows = [[name, default, "–", text] for name, default, text in _arguments(RandomDynamics)]
    for name in keyword_fields(robot_class.default_rules):
        default = _shown(theirs[name].default) if name in theirs else "–"
        rows.append([f"`{name}`", _shown(getattr(robot_class.default_rules, name)), default, docs[name]])
    rendering = ", ".join(f"`{name}`" for name in RENDER_KEYWORDS)
    return [
        "## Keyword arguments",
        table(["keyword", "default", "Gymnasium's", "meaning"], rows, numbers_from=None),
        _prose(
            f"Rendering is Gymnasium's own: {rendering}. Without a display, set `MUJOCO_GL=egl` (or `osmesa`) before "
            "Python starts; Gymnasium's `RecordVideo` needs `moviepy` too."
        ),
    ]


def _many(robot: str) -> list[str]:
    return [
        "## Many at once",
        _prose(
            f'`gymnasium.make_vec("{ids.v0_env_id(robot)}", num_envs=N)` steps N sub-environments together on threads, '
            "and gives the bits of N single ones. It takes the fields and the rendering arguments above, and those "
            "below. It alone spreads the dynamics of a split: with `vectorization_mode` `sync` or `async`, Gymnasium "
            "makes N times the same single environment, which takes `index`, or draws at every reset."
        ),
        table(
            ["keyword", "default", "meaning"],
            list(_arguments(RandomDynamicsVector, left_out=("robot", "kwargs"))),
            numbers_from=None,
        ),
    ]


def _arguments(owner: type, left_out: Sequence[str] = ("kwargs",)) -> Iterator[list[str]]:
    """Name, default and text of each entry under `Args:` of a class's `__init__`."""
    function: Any = owner.__init__  # type: ignore[misc]
    parameters = inspect.signature(function).parameters
    text = inspect.cleandoc(function.__doc__).partition("Args:\n")[2].partition("\n\n")[0]
    for name, meaning in re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE):
        if name not in left_out:
            meaning = " ".join(meaning.split())
            yield [f"`{name}`", _shown(parameters[name].default), meaning[0].upper() + meaning[1:]]


def _varied(robot: str, parameter: Parameter) -> list[tuple[str, NDArray[np.float64], int]]:
    """Name, nominal value and row of each element that a factor acts on."""
    nominal = nominal_robot(robot)
    names, values = nominal.names[parameter.element], nominal.values[parameter.field]
    return [(name, values[row], row) for row, name in enumerate(names) if np.any(values[row])]


def _factors(robot: str, split: str, parameter: Parameter) -> NDArray[np.float64]:
    """Factors of a parameter in the dynamics of a split, (dynamics, elements)."""
    every = [load_dynamics(robot, split, index) for index in range(ids.SPLIT_SIZES[split])]
    return np.stack([factor_array(robot, dynamics, parameter) for dynamics in every])


def _variation(robot: str) -> list[str]:
    blocks = [
        "## What varies",
        _prose(
            "The value of an element is its nominal value times its factor. The tables give the range of its factors "
            "among the train and the test dynamics; an element whose nominal value is 0 is left out."
        ),
    ]
    for parameter in draws.DRAWN:
        train, test = _factors(robot, "train", parameter), _factors(robot, "test", parameter)
        rows = [
            [f"`{name}`", _numbers(value), *_range(train[:, row]), *_range(test[:, row])]
            for name, value, row in _varied(robot, parameter)
        ]
        header = [parameter.element, f"nominal, {parameter.unit}", "train min", "train max", "test min", "test max"]
        blocks += [
            f"### {parameter.field}",
            _prose(f"{parameter.meaning.capitalize()}.{NUMBERS.get(parameter.field, '')}"),
            table(header, rows, numbers_from=1),
        ]
    return blocks


def _drawing(robot: str) -> list[str]:
    rows = []
    for parameter in draws.DRAWN:
        ends = _range(parameter.base ** np.array([-draws.LOG_RANGE, draws.LOG_RANGE]))
        count = len(_varied(robot, parameter))
        rows.append([f"`{parameter.field}`", parameter.unit, f"{parameter.base:g}^r", *ends, f"{count}"])
    docs = attribute_docs(draws)
    order = inspect.cleandoc(draws.draw_dynamics.__doc__ or "").split("\n\n")[1]
    (robot_number, train, _), (_, test, _) = (ids.make_id(robot, split, 0).key for split in ("train", "test"))
    return [
        "## How it was drawn",
        f"A factor is base^r, r ~ Uniform(−{draws.LOG_RANGE:g}, {draws.LOG_RANGE:g}), on the nominal value:",
        table(["parameter", "unit", "factor", "from", "to", "elements"], rows, numbers_from=2),
        _prose(f"{order} What MuJoCo derives from masses, inertias and friction is computed anew."),
        _prose(
            f"The draws are those of `numpy.random.SeedSequence({draws.SEED}, spawn_key=({robot_number}, split, "
            f"index))`, split {train} for train and {test} for test. The entropy "
            f"{draws.SEED} is {docs['SEED'].partition(': ')[2]} {docs['DECIMALS']}"
        ),
        f"```bash\ndynagen dynamics show {robot} test3  # every value of one dynamics\n"
        f"dynagen dynamics draw {robot} --seed 7  # a new draw, for dynamics=\n```",
    ]


def _test_factors(robot: str) -> list[str]:
    rows = []
    for parameter in draws.DRAWN:
        test = _factors(robot, "test", parameter)
        for name, _, row in _varied(robot, parameter):
            rows.append([f"`{parameter.field}`", f"`{name}`", *[f"{factor:.3f}" for factor in test[:, row]]])
    header = ["parameter", "element", *[name.label for name in ids.dynamics_ids(robot, ("test",))]]
    return [
        "<details>\n<summary>Factors of the five test dynamics</summary>",
        table(header, rows, numbers_from=2),
        "</details>",
    ]


def _prose(text: str) -> str:
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def _range(factors: NDArray[np.float64]) -> list[str]:
    return [f"{factors.min():.3f}", f"{factors.max():.3f}"]


def _numbers(value: NDArray[np.float64]) -> str:
    return " ".join(f"{number:.4g}" for number in np.atleast_1d(value))


def _shown(value: Any) -> str:
    """A default, as a reader of a table wants it."""
    if isinstance(value, tuple):
        return " to ".join(_shown(end) for end in value)
    if isinstance(value, enum.Enum):
        return f"{value.value}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{value}"
    return f"{value:g}".replace("-", "−") if math.isfinite(value) else "∞" if value > 0 else "−∞"
