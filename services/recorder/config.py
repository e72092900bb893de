"""What the recorder can be told."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class RecorderConfig(BaseModel):
    """Where a recording goes and how it is written."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    directory: Path = Field(default=Path(), description="Folder of the recording; it is made if it does not exist")
    file_name: str = Field(
        default="session.mcap",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap$",
        description="Name of the file; one that exists is kept and the new one is called NAME_1.mcap, NAME_2.mcap, ...",
    )
    flush_interval_s: Annotated[float, Field(ge=0.01, le=0.25)] = Field(
        default=0.2, description="Most that a kill of the recorder may lose [s], 0.01 to 0.25"
    )
    compression: Literal["zstd", "lz4", "none"] = Field(default="zstd", description="Compression of each chunk")
    chunk_size_bytes: Annotated[int, Field(ge=4096, le=64 << 20)] = Field(
        default=1 << 20, description="Size at which a chunk is closed before its flush [bytes], 4096 to 67108864"
    )
    sync_to_disk: bool = Field(
        default=False,
        description="Wait at each flush until the disk has the data: then a power cut loses no more either",
    )
