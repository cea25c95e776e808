"""Put the table of the study of many robots into docs/robust.md, and its picture beside it.

mcp-asdf reproduce --part scale --output FOLDER
PYTHONPATH=tests python -m benchmarks.scale_page FOLDER     # measures the costs again
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.robust_page import PAGE, ROOT, put_tables, small_picture
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.reproduction import scaling

PICTURE = ROOT / "docs/images/scale.webp"


def main() -> int:
    """Write the table between its marks, and the picture."""
    results = experiments_in(read_table(Path(sys.argv[1], "scale.parquet")))
    put_tables(PAGE, {"scale": scaling.lines_of(scaling.table(results))})
    PICTURE.write_bytes(small_picture(scaling.picture_of(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
