#!/usr/bin/env python3
"""Writes a bill of materials of the program as CycloneDX 1.5 JSON, from `cargo metadata` and Cargo.lock.

    packaging/sbom.py target/sbom.cdx.json [TARGET]

It lists the crates that are linked into `wavex` for a target, by default that of this machine, with versions,
licences, checksums and dependencies. Build-time, test and benchmark dependencies are omitted. The same commit gives
the same bytes.
"""

import json
import pathlib
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent


def host():
    """This machine's target."""
    version = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    return next(line.split()[1] for line in version.splitlines() if line.startswith("host:"))


def metadata(target):
    """Resolved packages for a target."""
    command = ["cargo", "metadata", "--format-version=1", "--locked", f"--filter-platform={target}"]
    return json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)


def linked(nodes, start):
    """Linked dependencies of a package, of these, and so on: identifiers with theirs."""
    found, open_ids = {}, [start]
    while open_ids:
        package = open_ids.pop()
        if package in found:
            continue
        is_linked = lambda dependency: any(kind["kind"] is None for kind in dependency["dep_kinds"])
        found[package] = sorted(d["pkg"] for d in nodes[package]["deps"] if is_linked(d))
        open_ids += found[package]
    return found


def main(path, target=None):
    about = metadata(target or host())
    packages = {package["id"]: package for package in about["packages"]}
    nodes = {node["id"]: node for node in about["resolve"]["nodes"]}
    program = next(id for id, package in packages.items() if package["name"] == "wavex")
    found = linked(nodes, program)
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text())
    checksums = {(p["name"], p["version"]): p.get("checksum") for p in lock["package"]}

    def reference(id):
        return f"pkg:cargo/{packages[id]['name']}@{packages[id]['version']}"

    def component(id):
        package = packages[id]
        checksum = checksums.get((package["name"], package["version"]))
        entry = {
            "type": "application" if id == program else "library",
            "bom-ref": reference(id),
            "name": package["name"],
            "version": package["version"],
            "purl": reference(id),
        }
        if package["license"]:
            # Older crates separate alternatives by a slash.
            entry["licenses"] = [{"expression": package["license"].replace("/", " OR ")}]
        if checksum:
            entry["hashes"] = [{"alg": "SHA-256", "content": checksum}]
        return entry

    others = sorted((id for id in found if id != program), key=reference)
    bill = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": component(program)},
        "components": [component(id) for id in others],
        "dependencies": [
            {"ref": reference(id), "dependsOn": [reference(d) for d in found[id]]} for id in [program, *others]
        ],
    }
    without = [entry["name"] for entry in bill["components"] if "licenses" not in entry]
    if without or not others:
        sys.exit(f"no licence is known of: {', '.join(without)}")
    pathlib.Path(path).write_text(json.dumps(bill, indent=1) + "\n")
    print(f"{path}: {len(others)} crates")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    main(*sys.argv[1:])
