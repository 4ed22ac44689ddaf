"""Unreadable files of a laboratory: the kind of each, and the way to convert it to a readable one."""

import shlex
import zipfile
from pathlib import Path

KINDS: dict[str, tuple[str, str]] = {  # name -> (what it is, what to do)
    "ros1": (
        "a ROS 1 bag",
        "convert it with rosbags-convert --src {name} --dst {stem} (installed with the extra logs) and import the folder {stem}",
    ),
    "active": ("a ROS 1 bag that was not closed", "run rosbag reindex, then rosbags-convert --src {stem} --dst swim"),
    "matlab": ("a MATLAB file", "write its columns as CSV, with writetable in MATLAB or scipy.io.loadmat in Python"),
    "hdf5": ("HDF5, which MATLAB also writes as .mat 7.3", "write its columns as CSV, with h5py or pandas in Python"),
    "workbook": ("a workbook of a spreadsheet", "save each sheet as CSV UTF-8 there"),
    "numpy": ("one array without names", "save it with numpy.savez under the names of its columns"),
    "pickle": ("a pickle, which may run code when it is loaded", "write its columns as CSV where it was made"),
    "feather": ("an Arrow file", "write it as Parquet: pyarrow.feather.read_table, pyarrow.parquet.write_table"),
    "json": ("JSON", "write its columns as CSV, or record its messages as MCAP"),
    "yaml": ("YAML, such as ros2 topic echo prints", "record with ros2 bag record and import the bag"),
    "px4": ("a PX4 log", "convert it with ulog2csv (pip install pyulog) and import the CSV files"),
    "dataflash": ("an ArduPilot log", "convert it with mavlogdump.py --format csv (pip install pymavlink)"),
    "tdms": ("a LabVIEW TDMS file", "write its channels as CSV, in LabVIEW or with the Python package npTDMS"),
    "mocap": ("a motion-capture file", "export the rigid bodies' tracking data as CSV"),
    "archive": ("an archive", "unpack it and import what is inside"),
    "video": ("a video", "fishmj deploy track finds the fish in it"),
    "robot": ("a robot's description and no recording", "fishmj new writes the description that fishmj reads"),
    "sqlite": ("an SQLite database", "a bag's ends in .db3; of another, write the tables as CSV"),
    "parquet": ("a Parquet file", "give its name the end .parquet"),
    "recording": ("an MCAP recording", "give its name the end .mcap"),
}
RECORDINGS = set("ros1 active matlab hdf5 workbook numpy feather px4 dataflash tdms mocap sqlite".split())
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".parquet", ".npz", ".mcap", ".db3", ".bag")
_STARTS = {  # first bytes -> name
    **{b"#ROSBAG V": "ros1", b"MATLAB 5.0": "matlab", b"\x89HDF\r\n": "hdf5", b"\xd0\xcf\x11\xe0": "workbook"},
    **{b"\x93NUMPY": "numpy", b"ARROW1": "feather", b"ULog": "px4", b"\xa3\x95\x80": "dataflash", b"TDSm": "tdms"},
    **{b"header:\n": "yaml", b"header: \n": "yaml"},
    **{b"\x1f\x8b": "archive", b"BZh": "archive", b"\xfd7zXZ": "archive", b"7z\xbc\xaf": "archive", b"Rar!": "archive"},
    **{b"SQLite format 3": "sqlite", b"PAR1": "parquet", b"\x89MCAP": "recording"},
}
_ENDS = {
    **dict.fromkeys((".bag",), "ros1"),
    **dict.fromkeys((".active",), "active"),
    **dict.fromkeys((".mat", ".fig", ".slx"), "matlab"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc"), "hdf5"),
    **dict.fromkeys((".xlsx", ".xlsm", ".xls", ".xlsb", ".ods", ".numbers"), "workbook"),
    **dict.fromkeys((".npy",), "numpy"),
    **dict.fromkeys((".pkl", ".pickle", ".joblib"), "pickle"),
    **dict.fromkeys((".feather", ".arrow"), "feather"),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), "json"),
    **dict.fromkeys((".yaml", ".yml"), "yaml"),
    **dict.fromkeys((".ulg", ".ulog"), "px4"),
    **dict.fromkeys((".tdms",), "tdms"),
    **dict.fromkeys((".c3d", ".tak", ".trc", ".qtm"), "mocap"),
    **dict.fromkeys((".zip", ".gz", ".tgz", ".tar", ".bz2", ".xz", ".7z", ".rar", ".zst", ".zstd"), "archive"),
    **dict.fromkeys((".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg"), "video"),
    **dict.fromkeys((".urdf", ".xacro", ".sdf", ".srdf", ".usd", ".xml"), "robot"),
    **dict.fromkeys((".db", ".sqlite", ".sqlite3"), "sqlite"),
}


def kind_of(path: Path, *, text: bool = False) -> str:
    """Name in KINDS of a file's kind, by its first bytes, else by the end of its name; "" for none that is known.

    Args:
        text: its name marks it as a table of text, so that only the first bytes decide.
    """
    try:
        with open(path, "rb") as file:
            start = file.read(16)
    except OSError:
        start = b""
    by_bytes = next((name for mark, name in _STARTS.items() if start.startswith(mark)), "")
    by_name = "" if text else _ENDS.get(path.suffix.lower(), "")
    if start.startswith(b"PK\x03\x04"):
        return by_name or ("workbook" if _is_workbook(path) else "archive")
    return by_bytes or by_name


def holds_tables(path: Path) -> bool:
    """Returns True for an archive of recordings: `camera.csv.gz`, or a zip file with one inside."""
    if any(suffix in _TABLES for suffix in map(str.lower, path.suffixes[-2:-1])):
        return True
    try:
        with zipfile.ZipFile(path) as archive:
            return any(Path(name).suffix.lower() in _TABLES for name in archive.namelist()[:1000])
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError):  # not a zip, damaged, or of a later form
        return False


def _is_workbook(path: Path) -> bool:
    """Returns True for a zip archive whose first pages name the parts of a workbook."""
    with open(path, "rb") as file:
        start = file.read(4096)
    return b"[Content_Types].xml" in start or b"xl/" in start or b"opendocument.spreadsheet" in start


def advice(path: Path, kind: str) -> str:
    """One clause: the kind of a file, and what to do."""
    what, remedy = KINDS[kind]
    return f"{what}, which is not read; {remedy.format(name=shlex.quote(path.name), stem=shlex.quote(path.stem))}"
