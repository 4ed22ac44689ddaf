"""Command lines as users mistype them, and what they name. Written by someone who knew the docs and not the code.

Every line of COMMANDS is wrong: exit code 2, one line on stderr that says what, nothing left behind, within seconds. Every
line of HOPELESS is well formed and would take days or terabytes on a machine without an accelerator: 2 with an estimate, or on
a terminal a question, as quickly.
"""

import hashlib
import json
import math
import re
from pathlib import Path

LINKS = (
    ("head", 0.24, 0.75, "[[0.0, 0.02, 0.014], [0.1, 0.09, 0.06], [0.24, 0.08, 0.05]]"),
    ("body", 0.08, 0.20, "[[0.0, 0.08, 0.05], [0.08, 0.06, 0.03]]"),
    ("waist", 0.08, 0.10, "[[0.0, 0.06, 0.03], [0.08, 0.05, 0.02]]"),
    ("tail", 0.20, 0.09, "[[0.0, 0.05, 0.02], [0.06, 0.04, 0.01], [0.2, 0.12, 0.002]]"),
)
TEXTS = {
    "measurements.toml": "[scales]\nwhole = [1.104, 1.103]\n",
    "notes.txt": "Monday: the fish swam well.\n",
    "policy.safetensors": "not a policy, a note to myself\n",
    "lab.csv": "time,servo1\n0.00,1.5\n0.02,2.5\n0.04,3.5\n",
    "verdict.json": '{"answer": 42}\n',
}


def without_progress(err: str) -> list[str]:
    """Lines of stderr that say something; a loaded machine adds those of a bar, after seconds that no test may count."""
    return [line for line in re.split(r"[\r\n]+", err) if line.strip() and not re.search(r"\[[#? ]{10,}\]", line)]


def _table(path: Path, head: str, rows: list[list[float]]) -> None:
    path.write_text("\n".join([head, *(",".join(f"{value:.5f}" for value in row) for row in rows)]) + "\n")


def _trial(folder: Path) -> None:
    """A measured trial of 4 s: three joints, a beat of 1 Hz."""
    folder.mkdir(parents=True)
    meta = {"schema": "fishmj.log/1", "origin": "measured", "robot": "swift", "medium": "water", "excitation": "gait"}
    (folder / "meta.toml").write_text("".join(f'{key} = "{value}"\n' for key, value in meta.items()) + "joints = 3\n")
    stamps = [0.02 * i for i in range(200)]
    wave = [[0.4 * math.sin(2 * math.pi * t - j) for j in range(3)] for t in stamps]
    _table(folder / "cmd.csv", "t,c1,c2,c3", [[t, *angles] for t, angles in zip(stamps, wave, strict=True)])
    joints = [[t + 0.003, *(0.9 * angle for angle in angles)] for t, angles in zip(stamps, wave, strict=True)]
    _table(folder / "joint.csv", "t,j1,j2,j3", joints)
    _table(folder / "pose.csv", "t,x,y,yaw", [[t + 0.01, 0.2 * t, 0.0, 0.1 * math.sin(6 * t)] for t in stamps])


def prepare(folder: Path) -> None:
    """Write what the commands name: `trial`, the data set `data` of two trials, `empty`, a fish `carp.toml`, and TEXTS."""
    folder.mkdir(parents=True, exist_ok=True)
    data = folder / "data"
    for place in (folder / "trial", data / "gait_1", data / "gait_2"):
        _trial(place)
    files = sorted(path for path in data.rglob("*") if path.is_file())
    sums = {path.relative_to(data).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    (data / "manifest.json").write_text(json.dumps({"meta": {"origin": "measured"}, "files": sums}, indent=1) + "\n")
    (folder / "empty").mkdir()
    fish = 'schema = "fishmj.fish/1"\nname = "carp"\n'
    for name, length, mass, sections in LINKS:
        fish += f'\n[[link]]\nname = "{name}"\nlength = {length}\nmass = {mass}\nsections = {sections}\n'
    (folder / "carp.toml").write_text(fish)
    for name, text in TEXTS.items():
        (folder / name).write_text(text)


COMMANDS: dict[str, list[str]] = {
    # the verb
    "verb_plural": ["evaluates", "dob"],
    "verb_hyphen": ["hydro-fit", "check", "--prior"],
    "verb_capital": ["Train", "--preset", "quick"],
    "verb_after_its_options": ["--preset", "quick", "train"],
    # doctor, demo, new
    "doctor_unknown_option": ["doctor", "--fix"],
    "demo_option_in_the_plural": ["demo", "--seeds", "1"],
    "demo_out_is_a_file": ["demo", "--out", "notes.txt"],
    "new_cm_without_a_unit": ["new", "pike", "--yes", "--length", "60"],
    "new_decimal_comma": ["new", "pike", "--yes", "--length", "0,6"],
    "new_links_and_joints": ["new", "pike", "--yes", "--links", "4", "--joints", "0.2,0.3,0.4"],
    "new_joints_reversed": ["new", "pike", "--yes", "--joints", "0.4,0.3,0.2"],
    "new_photo_is_a_text": ["new", "pike", "--yes", "--photo", "notes.txt"],
    "new_nobody_to_ask": ["new", "pike"],
    # train
    "train_steps_zero": ["train", "--steps", "0"],
    "train_envs_negative": ["train", "--envs", "-8"],
    "train_seeds_letters": ["train", "--seeds", "a,b"],
    "train_rate_nan": ["train", "--learning-rate", "nan"],
    "train_option_of_another_tool": ["train", "--lr", "0.001"],
    "train_seed_and_seeds": ["train", "--seed", "3", "--seeds", "0,1"],
    "train_critic_that_sac_has_not": ["train", "--algo", "sac", "--critic", "privileged"],
    "train_resume_nothing": ["train", "--resume", "--out", "runs/none"],
    "train_resume_and_force": ["train", "--resume", "--force", "--out", "runs/none"],
    "train_out_in_proc": ["train", "--out", "/proc/x/run"],
    "train_robot_is_another_toml": ["train", "--robot", "measurements.toml"],
    "train_reward_that_likes_to_be_far": ["train", "--reward", "wD=-1"],
    "train_episode_of_five_steps_and_a_half": ["train", "--episode-seconds", "1.1"],
    "train_rounds_of_nothing": ["train", "--rounds", "3"],
    "train_eddies_of_no_turbulence": ["train", "--turbulence", "none", "--intensity", "0.1"],
    # tune, evaluate
    "tune_same_twice": ["tune", "dob", "dob"],
    "evaluate_eddies_of_no_turbulence": ["evaluate", "dob", "--turbulence", "none", "--intensity", "0.1"],
    "evaluate_engine_beside_the_solver": ["evaluate", "dob", "--water", "lbm", "--engine", "planar"],
    "evaluate_same_twice": ["evaluate", "dob", "dob"],
    "evaluate_policy_is_a_text": ["evaluate", "policy.safetensors"],
    "evaluate_policy_missing": ["evaluate", "runs/quick-ppo-0/best.safetensors"],
    "evaluate_speed_with_its_unit": ["evaluate", "dob", "--speeds", "0.2m/s"],
    "evaluate_speeds_without_a_value": ["evaluate", "dob", "--speeds"],
    "evaluate_unicode_dash": ["evaluate", "dob", "\u2013speeds", "0.2"],
    "evaluate_backslash_of_the_shell": ["evaluate", "dob", "\\"],
    "evaluate_out_empty": ["evaluate", "dob", "--out="],
    "evaluate_out_in_proc": ["evaluate", "dob", "--out", "/proc/x"],
    "evaluate_water_is_a_fish": ["evaluate", "dob", "--water", "carp.toml"],
    "evaluate_half_a_step": ["evaluate", "dob", "--duration", "10.1", "--speeds", "0.2", "--repeats", "1"],
    "evaluate_domain_without_the_solver": ["evaluate", "dob", "--domain", "laptop", "--speeds", "0.2", "--repeats", "1"],
    # replay, play
    "replay_a_data_set": ["replay", "data"],
    "replay_out_is_a_folder": ["replay", "trial", "--out", "empty"],
    "replay_picture_after_the_end": ["replay", "trial", "--png", "late.png", "--at", "100"],
    "replay_out_twice": ["replay", "trial", "--out", "a.html", "--out", "b.html"],
    "play_controller_without_its_option": ["play", "dob"],
    "play_speed_inf": ["play", "--speed", "inf"],
    "play_save_is_there": ["play", "--save", "trial", "--headless-seconds", "1"],
    "play_box_without_the_solver": ["play", "--domain", "laptop", "--headless-seconds", "1"],
    "play_eddies_of_no_turbulence": ["play", "--turbulence", "none", "--intensity", "0.1", "--headless-seconds", "1"],
    # log
    "log_import_without_out": ["log", "import", "lab.csv"],
    "log_import_both_ways": ["log", "import", "lab.csv", "--out", "new", "--one-trial", "--trial-each"],
    "log_import_into_its_source": ["log", "import", "data", "--out", "data/new", "--yes"],
    "log_manifest_of_a_trial": ["log", "manifest", "trial"],
    "log_export_over_a_data_set": ["log", "export", "trial", "--to", "csv", "--out", "data", "--force"],
    # calibrate
    "calibrate_data_is_a_trial": ["calibrate", "servo", "--data", "trial", "--report", "rep"],
    "calibrate_ratios_without_recompute": ["calibrate", "slip", "--ratios", "0,0.9", "--report", "rep"],
    "calibrate_out_is_another_toml": ["calibrate", "mass", "--out", "measurements.toml", "--report", "rep"],
    "calibrate_robots_huge": ["calibrate", "check", "--robots", "1e30"],
    "calibrate_slip_on_a_gpu_without_the_solver": ["calibrate", "slip", "--device", "cuda", "--report", "rep"],
    # gap, effects
    "gap_without_a_command": ["gap"],
    "gap_find_in_a_trial": ["gap", "find", "trial", "--out", "report"],
    "gap_plant_typo": ["gap", "plant", "coulomb_frictoin=0.1", "--out", "new"],
    "gap_plant_unit": ["gap", "plant", "coulomb_friction=0.1Nm", "--out", "new"],
    "gap_plant_nan": ["gap", "plant", "command_latency=nan", "--out", "new"],
    "gap_plant_flow_without_direction": ["gap", "plant", "none", "--flow", "0.1", "--out", "new"],
    "gap_plant_none_and_one": ["gap", "plant", "none", "command_latency=0.04", "--out", "new"],
    "gap_apply_what_is_no_verdict": ["gap", "apply", "verdict.json"],
    "gap_bench_shard": ["gap", "bench", "--shard", "5/2"],
    "effects_hyphen": ["effects", "command-latency"],
    # hydro_fit, lbm_oracle
    "hydro_fit_seeds_dotted": ["hydro_fit", "ablation", "--seeds", "0..3", "--out", "fits"],
    "hydro_fit_check_of_a_model_and_of_none": ["hydro_fit", "check", "--model", "swift", "--prior"],
    "hydro_fit_name_of_nothing": ["hydro_fit", "check", "--name", "mine"],
    "hydro_fit_correct_bounds_reversed": ["hydro_fit", "correct", "pd", "--flow-speeds", "0.2,0.1"],
    "hydro_fit_rank_the_same": ["hydro_fit", "rank", "pd", "pd", "--out", "ranks"],
    "lbm_oracle_case_typo": ["lbm_oracle", "cases", "poiseuile"],
    "lbm_oracle_two_of_three_joints": ["lbm_oracle", "swim", "--preset", "laptop", "--amplitude", "30", "20"],
    "lbm_oracle_volume_without_fields": ["lbm_oracle", "swim", "--preset", "laptop", "--beats", "1", "--volume"],
    "lbm_oracle_speeds_with_a_blank": ["lbm_oracle", "forcemap", "--domain", "laptop", "--speeds", "0.1", "0.2", "--out", "maps"],
    # campaign, bench
    "campaign_truth_in_the_data": ["campaign", "hidden", "--out", "hidden", "--truth", "hidden/truth.json"],
    "campaign_out_is_a_data_set": ["campaign", "hidden_trials", "--out", "data"],
    "bench_names_with_a_comma": ["bench", "engine_batch,engine_planar"],
}

HOPELESS: dict[str, list[str]] = {
    "evaluate_in_the_solver": ["evaluate", "paper", "--water", "lbm"],
    "evaluate_24000_trials": ["evaluate", "paper", "--repeats", "1000", "--duration", "600"],
    "swim_an_hour_in_the_whole_tank": ["lbm_oracle", "swim", "--preset", "paper", "--seconds", "3600"],
    "speeds_of_1000_beats": ["lbm_oracle", "speeds", "--preset", "paper", "--beats", "1000", "--out", "speeds"],
    "forcemap_of_the_paper": ["lbm_oracle", "forcemap", "--out", "maps"],
    "collect_100_campaigns": ["hydro_fit", "collect", "--scale", "100", "--out", "collected"],
    "campaign_10000_sets": ["campaign", "hidden", "--sets", "10000", "--domain", "paper", "--out", "sets", "--truth", "t.json"],
    "train_a_million_fish_that_remember": ["train", "--envs", "1048576", "--memory", "1000", "--out", "runs/remember"],
    "train_sac_100_thousand_million_steps": ["train", "--algo", "sac", "--steps", "1e11", "--out", "runs/sac"],
    "gap_bench_100000_sessions": ["gap", "bench", "--cases", "100000", "--out", "blind"],
}
