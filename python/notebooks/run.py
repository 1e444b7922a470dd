"""Execute all notebooks without changing them; fails with the first that fails.

    python notebooks/run.py
"""

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
        start = time.perf_counter()
        NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
        print(f"{path.name}: {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
