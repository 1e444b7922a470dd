"""Refuses circles of imports between sibling files of the crates.

A file may use its parent's items and its children, which is how modules of Rust are divided; but of two
files or folders side by side, at most one uses the other, directly or through others. A name that the parent
re-exports counts as used from the file that defines it. Names in macros and method calls are not seen.

usage: check_circles.py [FOLDER ...]   (default: `src` and `crates/*/src`)
"""

import re
import sys
import tempfile
from pathlib import Path

ITEM = re.compile(r"\b(?:fn|struct|enum|trait|const|static|type|union|macro_rules!)\s+([A-Za-z_]\w*)")
PATH = re.compile(r"\b(?:(?:super|crate|self|[a-z_]\w*)::)+[A-Za-z_]\w*")


def code_of(path):
    """Code of a file without its tests, comments and texts."""
    text = path.read_text(encoding="utf-8").split("#[cfg(test)]\nmod tests {")[0]
    return re.sub(r'"(?:\\.|[^"\\])*"', '""', re.sub(r"//[^\n]*", "", text))


def flat(tree, prefix=()):
    """Paths and names of a `use` tree."""
    tree = tree.strip()
    if "{" not in tree:
        path, _, name = tree.partition(" as ")
        parts = [*prefix, *filter(None, (part.strip() for part in path.split("::")))]
        if parts and parts[-1] == "self":
            parts.pop()
        return [(tuple(parts), name.strip() or parts[-1])] if parts else []
    start = tree.index("{")
    prefix = (*prefix, *filter(None, (part.strip() for part in tree[:start].split("::"))))
    found, depth, entry = [], 0, ""
    for letter in tree[start + 1 : tree.rindex("}")] + ",":
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            found += flat(entry, prefix) if entry.strip() else []
            entry = ""
        else:
            entry += letter
    return found


class Crate:
    """Modules of a crate: their files, items and imports."""

    def __init__(self, root):
        self.code = {}
        for path in sorted(root.rglob("*.rs")):
            module = path.relative_to(root).with_suffix("").parts
            if "tests" not in module and module != ("main",):
                self.code[() if module == ("lib",) else module] = code_of(path)
        self.items = {module: set(ITEM.findall(code)) for module, code in self.code.items()}
        self.uses = {
            module: [use for tree in re.findall(r"\buse\s+([^;]+);", code) for use in flat(tree)]
            for module, code in self.code.items()
        }

    def absolute(self, module, path):
        """Path from the root of the crate; `None` for other crates."""
        if path[0] == "crate":
            return tuple(path[1:])
        if path[0] == "self":
            return (*module, *path[1:])
        if path[0] == "super":
            ups = next((i for i, part in enumerate(path) if part != "super"), len(path))
            return (*module[: max(0, len(module) - ups)], *path[ups:])
        if (*module, path[0]) in self.code:
            return (*module, *path)
        for other, name in self.uses[module]:
            if name == path[0] and other != path and other[0] in ("crate", "super", "self"):
                base = self.absolute(module, other)
                return (*base, *path[1:]) if base in self.code else None
        return None

    def defining(self, path, depth=0):
        """Module that defines the item of an absolute path, through re-exports."""
        if path is None or depth > 8:
            return None
        module = next(path[:k] for k in range(len(path), -1, -1) if path[:k] in self.code)
        rest = path[len(module) :]
        if not rest or rest[0] in self.items[module]:
            return module
        for other, name in self.uses[module]:
            if name == rest[0]:
                found = self.defining(self.absolute(module, (*other, *rest[1:])), depth + 1)
                if found is not None:
                    return found
            if name == "*":
                base = self.absolute(module, other[:-1])
                if base is not None and rest[0] in self.items.get(base, ()):
                    return base
        return None

    def edges(self):
        """Uses between siblings: names by folder, user and used."""
        found = {}
        for module, code in self.code.items():
            inline = PATH.findall(re.sub(r"\buse\s+[^;]+;", "", code))
            paths = [path for path, _ in self.uses[module]] + [tuple(path.split("::")) for path in inline]
            for path in paths:
                other = self.defining(self.absolute(module, path))
                if other is None:
                    continue
                shared = next((i for i, (a, b) in enumerate(zip(module, other)) if a != b), None)
                if shared is not None:
                    siblings = found.setdefault(module[:shared], {})
                    used = siblings.setdefault(module[shared], {})
                    used.setdefault(other[shared], set()).add(path[-1])
                    siblings.setdefault(other[shared], {})
        return found


def circles(edges):
    """Groups of siblings of which each uses each other, directly or through others."""

    def reached(start):
        seen, left = set(), [start]
        while left:
            for other in edges[left.pop()]:
                if other not in seen:
                    seen.add(other)
                    left.append(other)
        return seen

    reach = {name: reached(name) for name in edges}
    groups = {frozenset(b for b in reach[a] if a in reach[b]) for a in edges if a in reach[a]}
    return sorted(sorted(group) for group in groups)


def check(roots):
    """Prints the circles; returns their number."""
    count = 0
    for root in roots:
        for folder, edges in sorted(Crate(root).edges().items()):
            for circle in circles(edges):
                count += 1
                print(f"FAILED {root}: {'::'.join(folder) or 'lib'}: {len(circle)} files use each other")
                for name in circle:
                    uses = {other: sorted(names) for other, names in edges[name].items() if other in circle}
                    print(f"    {name} uses {uses}")
    return count


def sees_circles():
    """Whether a circle is found directly, through a re-export, and through a third file; and none without."""
    files = {
        "lib.rs": "mod a;\nmod b;\nmod c;\npub use b::B;\n",
        "a.rs": "use super::B;\npub struct A;\n",
        "b.rs": "pub struct B;\n// use crate::a::A;\n",
        "c.rs": "pub fn c() -> crate::a::A { crate::a::A }\n",
    }
    for change, expected in [({}, 0), ({"b.rs": "use super::a::A;\npub struct B;\n"}, 1), ({"b.rs": "use super::c::c;\npub struct B;\n"}, 1)]:
        with tempfile.TemporaryDirectory() as folder:
            for name, text in (files | change).items():
                (Path(folder) / name).write_text(text)
            found = sum(len(circles(edges)) for edges in Crate(Path(folder)).edges().values())
            if found != expected:
                print(f"FAILED: {found} circles instead of {expected} with {change}")
                return False
    return True


def main():
    roots = [Path(word) for word in sys.argv[1:]] or [Path("src"), *sorted(Path("crates").glob("*/src"))]
    if not sees_circles() or check(roots) > 0:
        sys.exit(1)
    print(f"no circles between sibling files of {len(roots)} crates")


if __name__ == "__main__":
    main()
