"""Reproduction of the paper's experiments, each by one command: `fishmj experiments NAME`.

Each file defines one experiment (`EXPERIMENT`, a `paper_experiment.PaperExperiment`): parts, whose rows are saved one by one, and
findings, which are computed from the saved rows.
"""

from importlib import import_module

from fishmj.evaluate.experiments.paper_experiment import PaperExperiment

MODULES = {  # name -> file, in the order of the paper
    "approach": "approach_target",
    "comparison": "controller_comparison",
    "angle_of_attack": "initial_angle",
    "figure_eight": "path_tracking",
    "saliency": "input_saliency",
    "rheotaxis": "rheotaxis_index",
    "flows": "unsteady_flows",
    "stages": "learning_stages",
    "ablations": "input_ablation",
}


def experiment_of(name: str) -> PaperExperiment:
    """Experiment by a name of `MODULES`."""
    return import_module(f"fishmj.evaluate.experiments.{MODULES[name]}").EXPERIMENT
