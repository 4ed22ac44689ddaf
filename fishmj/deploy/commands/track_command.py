"""`fishmj deploy track`: tracks the fish in a video file; writes a trial folder and an overlay video."""

from pathlib import Path

from fishmj.base import console
from fishmj.deploy.loop import wiring
from fishmj.deploy.tracker.video_tracking import track_video
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import identity
from fishmj.mjcf.reading import load_robot

EXAMPLES = """examples:
  fishmj deploy track swim.mp4 --calibration tank.toml --out runs/swim --overlay swim.overlay.mp4
  fishmj deploy track swim.mp4 --calibration tank.toml --tracker colour --out runs/swim"""
EARLY = 100  # frames without a fix after which a person is told
LEAST = 0.9  # share of the frames with a fix below which the exit code says so


def options() -> console.Parser:
    """The arguments."""
    made = console.parser("deploy track", "Poses of the fish in a video file, as a trial folder.", examples=EXAMPLES)
    add = made.add_argument
    add("video", type=console.path, help="a file that OpenCV reads")
    add("--out", type=console.out_folder, required=True, metavar="FOLDER", help="trial folder")
    add("--overlay", type=console.out_file, metavar="FILE", help="MP4 with what was found drawn over it (default none)")
    add("--robot", type=console.text, default="fish", help="its description, shipped name or TOML file; or a name for meta.toml")
    add("--overwrite", action="store_true", help="replace a trial that is there")
    wiring.tracker_options(made)
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: the fish is found in at least 90 % of the frames; 1: in fewer."""
    args = options().parse_args(argv)
    robot = load_robot(args.robot) if args.robot.endswith(".toml") else args.robot
    tracker = wiring.make_tracker(args, wiring.calibration_of(args, None), robot)
    with console.Progress(1, "track", "frames") as bar:

        def progress(done: int, total: int, fixes: int) -> None:
            bar.total = max(total, done)
            bar.update(done, fixes=fixes)
            if done == EARLY and not fixes:
                console.warn(
                    f"no fix in the first {EARLY} frames; if the fish is in them, stop and check the calibration, the "
                    "light, and the tag's number and size or the paint"
                )

        meta = {"robot": args.robot, "medium": "water"}
        if isinstance(robot, Robot):
            meta |= identity(robot)
        found = track_video(
            args.video, tracker, args.out, overlay=args.overlay, meta=meta, overwrite=args.overwrite, progress=progress
        )
    share = found.fixes / found.frames
    console.say(f"{found.fixes} fixes in {found.frames} frames ({100 * share:.1f} %), trial in {found.folder}")
    if args.json:
        result = {"frames": found.frames, "fixes": found.fixes, "rate": found.rate, "overlay": found.overlay}
        console.emit_json({**result, "out": Path(found.folder)})
    return console.OK if share >= LEAST else console.FAILED_CHECK
