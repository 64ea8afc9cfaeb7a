#!/usr/bin/env python3
"""Build this package beside the ROS 2 wheels, which bring its code generators and headers but not CMake's part of ROS.

With an installed ROS 2, colcon builds it by CMakeLists.txt. Both call the same generators, so that the types, and their hashes
on the graph, are equal. Needs a C and C++ compiler and Python's headers. Libraries go to `lib` of the environment in which this
runs, the Python package to its site-packages, the definitions to its `share`.
"""

import contextlib
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from itertools import product
from pathlib import Path

HERE = Path(__file__).resolve().parent
NAME = HERE.name
PREFIX = Path(sys.prefix)
USED = ("action_msgs", "service_msgs", "unique_identifier_msgs", "builtin_interfaces")
"""Packages whose types are part of every action."""
RUNTIME = (
    "generator_c",
    "generator_py",
    "typesupport_c",
    "typesupport_fastrtps_c",
    "typesupport_fastrtps_cpp",
    "typesupport_introspection_c",
)


def generate(action, out, introspection):
    """Write what the generators make of one .action file; two of them write a file of the same name, hence two folders."""
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_cpp.cli import GenerateCpp
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_fastrtps_cpp.cli import GenerateFastRTPSCppTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    convert_action_to_idl(HERE, NAME, action.relative_to(HERE), out / "action")
    what = (NAME, [f"{out}:action/{action.stem}.idl"], [str(PREFIX / "share")])
    HashTypeDescription("").generate_type_hashes(*what, out)
    described = [str(out / "action" / f"{action.stem}.json")]
    GenerateC("").generate(*what, out, type_description_files=described)
    GenerateCpp("").generate(*what, out, type_description_files=described)
    both = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
    GenerateCTypesupport("", typesupport_implementations=both).generate(*what, out)
    GenerateFastRTPSCppTypesupport("").generate(*what, out)
    GenerateFastRTPSCTypesupport("").generate(*what, out)
    GenerateIntrospectionCTypesupport("").generate(*what, introspection)


def compile_all(out, introspection, libraries):
    """Compile the generated code into the libraries that the type support looks for, and Python's module."""
    import numpy

    headers = [path for path in (PREFIX / "include").iterdir() if path.is_dir()]
    headers += [
        PREFIX / "include",
        out.parent,
        introspection.parent,
        sysconfig.get_path("include"),
        numpy.get_include(),
    ]
    common = [
        "-O1",
        "-shared",
        "-fPIC",
        *(f"-I{path}" for path in headers),
        f"-L{PREFIX / 'lib'}",
        f"-L{libraries}",
    ]
    # $ORIGIN: where they are installed, next to those that they use
    common += [f"-Wl,-rpath,$ORIGIN:{PREFIX / 'lib'}"]
    used = [f"-l{package}__rosidl_{part}" for package, part in product(USED, RUNTIME)]
    used += [
        "-lrosidl_runtime_c",
        *(f"-lrosidl_{part}" for part in RUNTIME[2:]),
        "-lfastcdr",
        "-lrmw",
        "-lstdc++",
    ]

    def link(target, sources, *ours):
        needs = [f"-l{NAME}__rosidl_{part}" for part in ours]
        command = [shutil.which("cc") or "gcc", *common, *map(str, sources), "-o", str(target), *needs, *used]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode:
            first = next((line for line in done.stdout.splitlines() if "error" in line), done.stdout.strip())
            raise SystemExit(f"{NAME}: the compiler ended with status {done.returncode}: {first}")

    action, ends = out / "action", ("functions", "description", "type_support")
    parts = {
        "generator_c": [path for end in ends for path in action.glob(f"detail/*__{end}.c")],
        "typesupport_fastrtps_c": [
            *action.glob("detail/*__type_support_c.cpp"),
            *action.glob("detail/dds_fastrtps/*.cpp"),
        ],
        "typesupport_introspection_c": [*introspection.glob("action/detail/*__type_support.c")],
        "typesupport_c": [*action.glob("*__type_support.cpp")],
    }
    for part, sources in parts.items():
        ours = () if part == "generator_c" else ("generator_c",)
        link(libraries / f"lib{NAME}__rosidl_{part}.so", sources, *ours)
    entry = out / f"_{NAME}_s.ep.rosidl_typesupport_c.c"
    module = out / f"{NAME}_s__rosidl_typesupport_c.so"
    link(module, [*action.glob("_*_s.c"), entry], "generator_c", "typesupport_c")
    return module


def main():
    """Generate, compile, install; end with one line where that cannot be."""
    if not shutil.which("cc") and not shutil.which("gcc"):
        raise SystemExit(f"{NAME}: found no C compiler, need one (Debian, Ubuntu: apt install g++)")
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SystemExit(
            f"{NAME}: found no Python.h, need Python's headers (Debian, Ubuntu: apt install python3-dev)"
        )
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)
    from rosidl_generator_py.cli import GeneratePython

    with tempfile.TemporaryDirectory() as folder:
        out, introspection = Path(folder, "plain", NAME), Path(folder, "introspection", NAME)
        libraries = Path(folder, "lib")
        for each in (out, introspection, libraries):
            each.mkdir(parents=True)
        with contextlib.redirect_stdout(
            io.StringIO()
        ):  # the adapter names each file that it reads and writes
            actions = sorted(HERE.glob("action/*.action"))
            for action in actions:
                generate(action, out, introspection)
            files = [f"{out}:action/{action.stem}.idl" for action in actions]
            python = GeneratePython("", typesupport_implementations=["rosidl_typesupport_c"])
            python.generate(NAME, files, [str(PREFIX / "share")], out)
        module = compile_all(out, introspection, libraries)
        package = Path(sysconfig.get_path("purelib"), NAME)
        (package / "action").mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").touch()
        for path in (out / "action").glob("*.py"):
            shutil.copy(path, package / "action")
        shutil.copy(module, package)
        share, index = PREFIX / "share" / NAME, PREFIX / "share" / "ament_index" / "resource_index"
        (share / "action").mkdir(parents=True, exist_ok=True)
        for path in [*actions, *(out / "action").glob("*.idl"), *(out / "action").glob("*.json")]:
            shutil.copy(path, share / "action")
        shutil.copy(HERE / "package.xml", share)
        named = {
            "packages": [],
            "rosidl_interfaces": [f"action/{a.stem}{end}" for a in actions for end in (".action", ".idl")],
        }
        for kind, lines in named.items():
            (index / kind).mkdir(parents=True, exist_ok=True)
            (index / kind / NAME).write_text("\n".join(lines))
        for path in libraries.iterdir():  # last: whoever finds the package finds all of it
            shutil.copy(path, PREFIX / "lib")


if __name__ == "__main__":
    main()
