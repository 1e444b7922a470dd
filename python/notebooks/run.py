"""Execute all notebooks without changing them; fails with the first that fails.

    python notebooks/run.py

A notebook that needs real recordings names their folder in its metadata, and is skipped where `WAVEX_DATA` lacks it.
"""

import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def main() -> None:
    """Run the notebooks of this folder."""
    here = Path(__file__).parent
    for path in sorted(here.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        written = [cell for cell in notebook.cells if cell.get("outputs")]
        if written:
            sys.exit(f"{path.name}: cells have outputs; clear them before committing")
        needs = notebook.metadata.get("wavex", {}).get("needs")
        if needs and not (Path(os.environ.get("WAVEX_DATA", "/nowhere")) / needs).is_dir():
            print(f"SKIPPED: {path.name}: WAVEX_DATA has no folder {needs}", flush=True)
            continue
        start = time.perf_counter()
        NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
        print(f"{path.name}: {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
