"""Run folder: what a live session leaves behind, readable at every moment of it and after any accident.

* ``about.json``: the scene, versions, and what each column is;
* ``ticks-N.arrows``: every tick, an Arrow stream of whole batches, while the session runs. ``N`` counts recorders: one
  that died has a successor;
* ``ticks.parquet``: the same in one file, when the session has ended; the streams are then gone;
* ``frames.bin``: what the page was shown, see `optsc.live.frames`, each frame behind its length in four bytes.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet

from optsc.errors import DamagedFile
from optsc.live.scene import SceneChoice

FORMAT = 1
"""Version of the folder; a newer one is refused."""
TICKS, FRAMES, ABOUT = "ticks.parquet", "frames.bin", "about.json"


class RunFolder:
    """A run to be read.

    Args:
        path: the folder.

    Attributes:
        path: the same.
        about: scene, versions and columns.

    Raises:
        DamagedFile: it is no run, or one of a newer version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self.about: dict[str, Any] = json.loads((self.path / ABOUT).read_text(encoding="utf-8"))
            version = int(self.about["format"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DamagedFile(self.path, f"is no recorded run ({error})") from None
        if version > FORMAT:
            raise DamagedFile(self.path, f"has format {version}, and this version reads up to {FORMAT}")

    @property
    def choice(self) -> SceneChoice:
        """The scene of the run; raise `DamagedFile`."""
        try:
            scene = dict(self.about["scene"])
            return SceneChoice(**{**scene, "objects": tuple(scene["objects"])})
        except (LookupError, TypeError, ValueError) as error:
            raise DamagedFile(self.path / ABOUT, f"names no scene ({error})") from None

    @property
    def streams(self) -> list[Path]:
        """The streams that are there, in their order."""
        return sorted(self.path.glob("ticks-*.arrows"), key=lambda path: int(path.stem.partition("-")[2]))

    def ticks(self) -> pyarrow.Table:
        """Return all ticks that were kept, from the one file or from what there is of streams; raise `DamagedFile`."""
        if (self.path / TICKS).exists():
            try:
                return parquet.read_table(self.path / TICKS)
            except (OSError, pyarrow.ArrowInvalid) as error:
                raise DamagedFile(self.path / TICKS, f"cannot be read ({error})") from None
        batches = list(_once(self.streams))
        if not batches:
            raise DamagedFile(self.path, "has no tick in it")
        return pyarrow.Table.from_batches(batches)

    def frames(self) -> bytes:
        """Return the frames as `optsc.live.site.single_file` takes them, up to the last whole one."""
        try:
            data = (self.path / FRAMES).read_bytes()
        except OSError as error:
            raise DamagedFile(self.path / FRAMES, f"cannot be read ({error.strerror})") from None
        return data[: whole_frames(data)]


def whole_batches(stream: Path) -> Iterator[pyarrow.RecordBatch]:
    """Return the batches of an Arrow stream up to the last one that was written as a whole."""
    with pyarrow.OSFile(str(stream)) as file:
        try:
            reader = pyarrow.ipc.open_stream(file)
            while True:
                yield reader.read_next_batch()
        except (StopIteration, pyarrow.ArrowInvalid, OSError):
            return  # its writer was killed in the middle of one, or had not begun


def _once(streams: Sequence[Path]) -> Iterator[pyarrow.RecordBatch]:
    """Return the batches of all streams, without ticks that a killed recorder left and its successor wrote too."""
    last = -math.inf
    for stream in streams:
        for batch in whole_batches(stream):
            clock = batch.column("clock").to_numpy()
            batch = batch.slice(int(np.searchsorted(clock, last, side="right")))
            if len(batch):
                last = float(clock[-1])
                yield batch


def whole_frames(data: bytes) -> int:
    """Return where the last frame ends that is there as a whole."""
    end = 0
    while end + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, end)
        if end + 4 + length > len(data):
            break
        end += 4 + length
    return end


def in_one_file(path: Path) -> int:
    """Make one Parquet file of the streams of a folder, batch by batch, and return how many ticks it has.

    The streams are removed when it is whole. Without a tick there is no file.
    """
    folder, count = RunFolder(path), 0
    part, writer = path / f"{TICKS}.part", None
    try:
        for batch in _once(folder.streams):
            if writer is None:
                writer = parquet.ParquetWriter(part, batch.schema, compression="zstd")
            writer.write_batch(batch)
            count += len(batch)
    finally:
        if writer is not None:
            writer.close()
    if count:
        part.replace(path / TICKS)
        for stream in folder.streams:
            stream.unlink()
    return count
