"""The paper's experiments, each remade by one command: `fishmj experiments NAME`.

One file makes one experiment (`EXPERIMENT`, a `paper_experiment.PaperExperiment`): parts that run and are kept one by one, and
findings that are made from the kept rows alone.
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
