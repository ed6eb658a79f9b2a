"""What may differ between bodies: factors as data, their draws, and their way into a MuJoCo model."""

from dynagen_bench.dynamics.draws import DRAWN, draw_dynamics, draw_split, drawn_factors, draws_json, load_dynamics
from dynagen_bench.dynamics.parameters import (
    PARAMETERS,
    Dynamics,
    Parameter,
    apply_dynamics,
    compile_nominal,
    factor_array,
    model_path,
    nominal_robot,
)

__all__ = [
    "DRAWN",
    "PARAMETERS",
    "Dynamics",
    "Parameter",
    "apply_dynamics",
    "compile_nominal",
    "draw_dynamics",
    "draw_split",
    "drawn_factors",
    "draws_json",
    "factor_array",
    "load_dynamics",
    "model_path",
    "nominal_robot",
]
