#!/usr/bin/env python3
"""Checks the recipes for conda and Homebrew, and fills them for a release.

    packaging/recipes.py check
    packaging/recipes.py fill target/dist
    packaging/recipes.py test

`check` compares them with Cargo.toml: version, licence, address, and the keys that a recipe needs. `fill` writes them
to the folder of a release with the checksum of its source archive, and the release notes from CHANGELOG.md as NOTES.md.
`test` breaks the recipes in every way that `check` must notice.
Needs PyYAML; Ruby checks the syntax of the formula where it is installed.
"""

import hashlib
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import yaml

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECIPE = ROOT / "packaging/conda/recipe.yaml"
FORMULA = ROOT / "packaging/homebrew/wavex.rb"
# In the repository; `fill` replaces it.
NO_CHECKSUM = "0" * 64
# Licences of the libraries: a build writes this file.
LIBRARIES = "THIRDPARTY.yml"

ABOUT = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]
VERSION = ABOUT["version"]
SOURCE = f"wavex-{VERSION}-source.tar.gz"
URL = f"{ABOUT['homepage']}/releases/{VERSION}/{SOURCE}"
LICENCES = ABOUT["license"].split(" OR ")


def conda(text):
    """Properties of the recipe for conda; a missing key is an error."""
    recipe = yaml.safe_load(text)
    version = recipe["context"]["version"]
    about = recipe["about"]
    own = [name for name in about["license_file"] if name != LIBRARIES]
    files = [name for name in own if not (ROOT / name).is_file()]
    missing = [key for key in ("schema_version", "build", "requirements", "tests") if not recipe.get(key)]
    return {
        "name": recipe["package"]["name"],
        "version": version,
        "homepage": about["homepage"],
        "url": recipe["source"]["url"].replace("${{ version }}", version),
        "licences": about["license"].split(" OR "),
        "checksum": recipe["source"]["sha256"],
        "missing": missing + files,
    }


def homebrew(text):
    """Properties of the formula for Homebrew; a missing one is an error."""
    value = lambda key: re.search(rf'^  {key} "(.*)"$', text, re.MULTILINE)[1]
    licences = re.search(r"^  license any_of: \[(.*)\]$", text, re.MULTILINE)[1]
    url = value("url")
    parts = [r"^class Wavex < Formula$", r"^  def install$", r"^  test do$", r"^end$", r'^  depends_on "rust"']
    return {
        "name": "wavex",
        "version": url.split("/")[-2],
        "homepage": value("homepage"),
        "url": url,
        "licences": re.findall(r'"([^"]*)"', licences),
        "checksum": value("sha256"),
        "missing": [part for part in parts if not re.search(part, text, re.MULTILINE)],
    }


def problems(recipe, formula, checksum):
    """Differences of both from Cargo.toml."""
    expected = {
        "name": "wavex",
        "version": VERSION,
        "homepage": ABOUT["homepage"],
        "url": URL,
        "licences": LICENCES,
        "checksum": checksum,
        # Keys, parts and files.
        "missing": [],
    }
    result = []
    for path, read, text in ((RECIPE, conda, recipe), (FORMULA, homebrew, formula)):
        try:
            found = read(text)
        except (KeyError, TypeError, yaml.YAMLError) as error:
            result.append(f"{path.name}: a key is missing or malformed: {error}")
            continue
        different = [key for key in expected if found[key] != expected[key]]
        result += [f"{path.name}: {key} is {found[key]}, not {expected[key]}" for key in different]
    if shutil.which("ruby"):
        ruby = subprocess.run(["ruby", "-c"], input=formula, capture_output=True, text=True)
        result += [f"{FORMULA.name}: {ruby.stderr.strip()}"] if ruby.returncode else []
    else:
        print("SKIPPED: the syntax of the formula: Ruby is not installed")
    return result


def check(recipe, formula, checksum):
    """Exits with all differences."""
    if found := problems(recipe, formula, checksum):
        sys.exit("\n".join(found))


def test(recipe, formula):
    """Breaks both; exits if a change is not noticed."""
    changes = [
        (VERSION, "9.9.9"),
        (ABOUT["homepage"], "https://elsewhere.example"),
        ("MIT", "GPL-3.0-only"),
        ("-source.tar.gz", ".zip"),
        (NO_CHECKSUM, NO_CHECKSUM[1:]),
    ]
    of_recipe = [("LICENSE-MIT", "LICENSE"), ("tests:", "test:"), ("name: wavex", "name: wave"), ("build:", "build: [")]
    of_formula = [("  def install", "  def compile"), ("class Wavex", "class Waves"), ("  license", "  licence")]
    for old, new in changes + of_recipe:
        if not problems(recipe.replace(old, new), formula, NO_CHECKSUM):
            sys.exit(f"{RECIPE.name}: `{new}` in place of `{old}` is not noticed")
    for old, new in changes + of_formula + [("\nend", "\n")]:
        if not problems(recipe, formula.replace(old, new), NO_CHECKSUM):
            sys.exit(f"{FORMULA.name}: `{new}` in place of `{old}` is not noticed")
    print(f"{2 * len(changes) + len(of_recipe) + len(of_formula) + 1} changes are noticed")


def notes():
    """The section of the version in CHANGELOG.md, without its title; before the release, `Unreleased`."""
    sections = re.split(r"^## (.*)\n", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    by_title = {title.split()[0].strip("[]"): text for title, text in zip(sections[1::2], sections[2::2])}
    if VERSION not in by_title:
        print(f"NOTE: CHANGELOG.md has no section {VERSION}; the notes are those of `Unreleased`")
    text = by_title.get(VERSION) or by_title.get("Unreleased", "")
    if not text.strip():
        sys.exit(f"CHANGELOG.md has no section for {VERSION}")
    return f"# wavex {VERSION}\n\n{text.strip()}\n"


def main(arguments):
    recipe, formula = RECIPE.read_text(), FORMULA.read_text()
    match arguments:
        case ["check"]:
            check(recipe, formula, NO_CHECKSUM)
            print("both recipes agree with Cargo.toml")
        case ["test"]:
            test(recipe, formula)
        case ["fill", folder]:
            folder = pathlib.Path(folder)
            checksum = hashlib.sha256((folder / SOURCE).read_bytes()).hexdigest()
            recipe, formula = (text.replace(NO_CHECKSUM, checksum) for text in (recipe, formula))
            check(recipe, formula, checksum)
            (folder / RECIPE.name).write_text(recipe)
            (folder / FORMULA.name).write_text(formula)
            (folder / "NOTES.md").write_text(notes())
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
