"""The whole box and the fish in it for ParaView: VTK's own XML files, written directly, so that nothing has to be installed.

    00012.vti     ImageData: velocity (3), vorticity_z, q_criterion at every node, the time
    00012.vtp     PolyData: the fish's skin with its colours
    volume.pvd    both over time: open this one

Binary parts are appended raw and compressed with zlib in blocks, as VTK's `vtkZLibDataCompressor` reads them. Mantissas are
rounded to float16's 11 significant bits (the range stays that of float32), which reduces the compressed size to 69 %.

    Q = (|W|^2 - |S|^2) / 2 = -1/2 du_i/dx_j du_j/dx_i        S, W strain and spin; Q > 0 where the water turns; incompressible
"""

import sys
import zlib
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from fishmj.base.store import write_bytes, write_text
from fishmj.mjcf.skin import Skin, posed

BLOCK = 2**20  # bytes that are compressed at a time
ORDER = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
NAMES = {"f4": "Float32", "f8": "Float64", "i4": "Int32", "u1": "UInt8"}


def write_box(path: str | Path, velocity: np.ndarray, dx: float, low, t: float) -> Path:
    """Writes (nx, ny, nz, 3) m/s on nodes dx apart from `low` (3,) m as ImageData at time t s."""
    omega, q = turning(velocity, dx)
    fields = {"velocity": velocity, "vorticity_z": omega, "q_criterion": q}
    flat = {name: _rounded(np.asarray(f, np.float32)).swapaxes(0, 2) for name, f in fields.items()}  # VTK counts x fastest
    whole = quoteattr(" ".join(f"0 {n - 1}" for n in velocity.shape[:3]))
    origin = " ".join(f"{float(v):.9g}" for v in low)
    grid = f'WholeExtent={whole} Origin="{origin}" Spacing="{dx:.9g} {dx:.9g} {dx:.9g}"'
    made = _Appended()
    inside = made.group("PointData", flat, 'Scalars="vorticity_z" Vectors="velocity"')
    return _write(path, "ImageData", grid, made, f"{made.time(t)}<Piece Extent={whole}>{inside}</Piece>")


def write_fish(path: str | Path, skin: Skin, q, height: float, t: float) -> Path:
    """Writes the skin at q = (x, y, yaw, joints) m, rad and mid-height `height` m as PolyData at time t s."""
    points = (posed(skin, q) + (0.0, 0.0, height)).astype(np.float32)
    colour = (255 * skin.colour + 0.5).astype(np.uint8)
    made = _Appended()
    inside = made.group("PointData", {"colour": colour}, 'Scalars="colour"') + made.group("Points", {"points": points})
    ends = np.arange(3, 3 * len(skin.faces) + 1, 3, dtype=np.int32)
    inside += made.group("Polys", {"connectivity": skin.faces.astype(np.int32).ravel(), "offsets": ends})
    piece = f'<Piece NumberOfPoints="{len(points)}" NumberOfPolys="{len(skin.faces)}">{inside}</Piece>'
    return _write(path, "PolyData", "", made, made.time(t) + piece)


def write_series(path: str | Path, frames: list[tuple[float, list[str]]]) -> Path:
    """Writes the list (time s, files beside it) that ParaView opens as one film."""
    rows = [
        f'<DataSet timestep="{t:.6g}" group="" part="{part}" file={quoteattr(name)}/>'
        for t, names in frames
        for part, name in enumerate(names)
    ]
    text = "\n".join(
        ['<?xml version="1.0"?>', '<VTKFile type="Collection">', "<Collection>", *rows, "</Collection>", "</VTKFile>", ""]
    )
    return write_text(path, text)


def turning(velocity: np.ndarray, dx: float) -> tuple[np.ndarray, np.ndarray]:
    """omega_z [1/s] and Q [1/s2] of (nx, ny, nz, 3) m/s."""
    gradient = [np.gradient(velocity[..., i], dx) for i in range(3)]  # gradient[i][j] = du_i/dx_j
    q = -0.5 * sum(gradient[i][j] * gradient[j][i] for i in range(3) for j in range(3))
    return gradient[1][0] - gradient[0][1], q


def _rounded(field: np.ndarray) -> np.ndarray:
    """Field as float32 with the 12 lowest of 23 stored bits rounded away; values that are not finite stay."""
    bits = np.ascontiguousarray(field).view(np.uint32)
    return np.where(np.isfinite(field), ((bits + np.uint32(0x800)) & np.uint32(0xFFFFF000)).view(np.float32), field)


class _Appended:
    """Arrays that follow the XML, each named there by its offset."""

    def __init__(self):
        self.parts: list[bytes] = []
        self.size = 0

    def add(self, name: str, array: np.ndarray) -> str:
        """Keeps an array and returns its XML element. Arrays of one dimension less than their group's have one component."""
        kind = NAMES[array.dtype.str[1:]]
        width = array.shape[-1] if array.ndim in (2, 4) else 1
        data = _blocks(np.ascontiguousarray(array).tobytes())
        element = f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{width}" format="appended"'
        element += f' offset="{self.size}"/>'
        self.parts.append(data)
        self.size += len(data)
        return element

    def group(self, tag: str, arrays: dict[str, np.ndarray], about: str = "") -> str:
        return f"<{tag} {about}>" + "".join(self.add(name, array) for name, array in arrays.items()) + f"</{tag}>\n"

    def time(self, t: float) -> str:
        return f'<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1">{t:.9g}</DataArray></FieldData>\n'


def _blocks(data: bytes) -> bytes:
    """Compressed data: count, block size, size of the last part, compressed sizes; then the blocks."""
    parts = [zlib.compress(data[k : k + BLOCK], 1) for k in range(0, len(data), BLOCK)]
    header = [len(parts), BLOCK, len(data) % BLOCK, *map(len, parts)]
    return np.array(header, np.uint64).tobytes() + b"".join(parts)


def _write(path: str | Path, kind: str, about: str, made: _Appended, inside: str) -> Path:
    head = f'<VTKFile type="{kind}" version="1.0" byte_order="{ORDER}" header_type="UInt64" compressor="vtkZLibDataCompressor">'
    text = f'<?xml version="1.0"?>\n{head}\n<{kind} {about}>\n{inside}</{kind}>\n<AppendedData encoding="raw">\n_'
    return write_bytes(path, text.encode() + b"".join(made.parts) + b"\n</AppendedData>\n</VTKFile>\n")
