"""Generates the protobuf and gRPC modules of `sightline.v1` from `proto/`, or checks that they are current.

    python clients/python/generate.py            # writes src/sightline/v1
    python clients/python/generate.py --check    # exit status 1 if anything there is not what proto/ generates

Needs grpcio-tools in the version of `ci-requirements.txt`: other versions write other code.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from grpc_tools import protoc

HERE = Path(__file__).resolve().parent
PROTO = HERE.parent.parent / "proto"
PACKAGE = Path("sightline/v1")
GENERATED = ("*_pb2.py", "*_pb2.pyi", "*_pb2_grpc.py")


def generate(root: Path) -> None:
    """Writes the modules of the package under `root`."""
    sources = sorted(str(path.relative_to(PROTO)) for path in (PROTO / PACKAGE).glob("*.proto"))
    outputs = [f"--{kind}_out={root}" for kind in ("python", "pyi", "grpc_python")]
    if protoc.main(["protoc", f"-I{PROTO}", *outputs, *sources]) != 0:
        sys.exit("protoc refused; see above")
    for module in (root / PACKAGE).glob("*_pb2_grpc.py"):
        source = (PROTO / PACKAGE / module.name.replace("_pb2_grpc.py", ".proto")).read_text()
        if "\nservice " not in source:
            module.unlink()


def contents(root: Path) -> dict[str, str]:
    """The generated modules under `root`, by name."""
    return {path.name: path.read_text() for kind in GENERATED for path in (root / PACKAGE).glob(kind)}


def main() -> None:
    target = HERE / "src"
    if sys.argv[1:] not in ([], ["--check"]):
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        fresh = Path(folder)
        (fresh / PACKAGE).mkdir(parents=True)
        generate(fresh)
        new, old = contents(fresh), contents(target)
    stale = sorted(name for name in new.keys() | old.keys() if new.get(name) != old.get(name))
    if "--check" in sys.argv:
        if stale:
            names = ", ".join(stale)
            sys.exit(f"not what proto/ generates: {names}\nrun: python clients/python/generate.py, and commit the result")
        return
    for name in stale:
        path = target / PACKAGE / name
        path.write_text(new[name]) if name in new else path.unlink()
    print(f"{len(stale)} of {len(new)} modules changed")


if __name__ == "__main__":
    main()
