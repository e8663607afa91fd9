# pyright: basic, reportMissingImports=false
# mypy: ignore-errors
"""Builds a package with an action type from the ROS 2 wheels alone: `interfaces.py FOLDER`, with gcc and g++.

No wheel has an action type. The generators are called one by one, as rosidl's cmake code does, and all that they
generate is linked into libraries beside the extension module. The package is `robot_msgs` in FOLDER, which has to
stand on PYTHONPATH.
"""

import contextlib
import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGE = "robot_msgs"
ACTIONS = {
    "Turn": """\
float64 angle
float64 seconds
---
float64 reached
string said
---
float32 share
""",
}
DEPENDENCIES = ("action_msgs", "builtin_interfaces", "service_msgs", "unique_identifier_msgs")
PREFIX = Path(sys.prefix)


def build(folder: Path) -> None:
    """Generate and compile the package into the folder."""
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_generator_c import generate_c as generate_structures
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)
    source, idl = folder / "source", folder / "idl"
    (source / "action").mkdir(parents=True)
    for name, text in ACTIONS.items():
        (source / "action" / f"{name}.action").write_text(text)
        with contextlib.redirect_stdout(sys.stderr):
            convert_action_to_idl(source, PACKAGE, Path("action") / f"{name}.action", idl / "action")

    def arguments(generator: str, output: Path | None = None) -> str:
        path = folder / f"{generator}.json"
        content = {
            "package_name": PACKAGE,
            "output_dir": str(output or folder / generator / PACKAGE),
            "template_dir": str(PREFIX / "share" / generator / "resource"),
            "idl_tuples": [f"{idl}:action/{name}.idl" for name in ACTIONS],
            "ros_interface_dependencies": [],
            "ros_interface_files": [],
            "target_dependencies": [],
            "include_paths": [f"{name}:{PREFIX / 'share' / name}" for name in DEPENDENCIES],
            "type_description_tuples": [f"action/{name}.idl:{folder}/hashes/action/{name}.json" for name in ACTIONS],
        }
        path.write_text(json.dumps(content))
        return str(path)

    supports = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
    generate_type_hash(arguments("rosidl_generator_type_description", folder / "hashes"))
    generate_structures(arguments("rosidl_generator_c"))
    generate_typesupport_fastrtps_c(arguments(supports[0]))
    generate_introspection(arguments(supports[1]))
    generate_dispatch(arguments("rosidl_typesupport_c"), supports)
    generate_py(arguments("rosidl_generator_py", folder / PACKAGE), ["rosidl_typesupport_c"])
    (folder / PACKAGE / "__init__.py").touch()
    for library in ("rosidl_generator_c", *supports):
        lines = [f"#define {library.upper()}_{what}_{PACKAGE}" for what in ("EXPORT", "IMPORT", "PUBLIC")]
        header = folder / library / PACKAGE / "msg" / f"{library}__visibility_control.h"
        header.parent.mkdir(exist_ok=True)
        header.write_text("\n".join(["#pragma once", *lines, ""]))

    generators = ("rosidl_generator_c", *supports, "rosidl_typesupport_c")
    includes = [f"-I{folder / generator}" for generator in generators]
    libraries = [_compile(folder, generator, includes) for generator in generators]
    _link(
        folder / PACKAGE / f"{PACKAGE}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}",
        _objects(folder / PACKAGE, folder / "objects", includes),
        libraries,
    )


def _compile(folder: Path, generator: str, includes: list[str]) -> str:
    name = f"{PACKAGE}__{generator}"
    objects = _objects(folder / generator, folder / "objects" / generator, includes)
    _link(folder / PACKAGE / f"lib{name}.so", objects, [])
    return name


def _objects(folder: Path, objects: Path, includes: list[str]) -> list[str]:
    import numpy as np

    objects.mkdir(parents=True, exist_ok=True)
    everywhere = [PREFIX / "include", *sorted((PREFIX / "include").iterdir())]
    flags = [*includes, *(f"-I{path}" for path in everywhere)]
    flags += [f"-I{sysconfig.get_path('include')}", f"-I{np.get_include()}"]
    made: list[str] = []
    for path in sorted([*folder.rglob("*.c"), *folder.rglob("*.cpp")]):
        compiler = ("gcc", "-std=gnu11") if path.suffix == ".c" else ("g++", "-std=gnu++17")
        made.append(str(objects / f"{path.stem}.o"))
        subprocess.run([*compiler, "-O0", "-fPIC", "-w", *flags, "-c", str(path), "-o", made[-1]], check=True)
    return made


def _link(to: Path, objects: list[str], own: list[str]) -> None:
    """Link a library; the type supports are found by their names, which the loader knows once they are loaded."""
    kinds = ("rosidl_generator_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c")
    libraries = [f"{name}__{kind}" for name in DEPENDENCIES for kind in (*kinds, "rosidl_generator_py")]
    libraries += [f"{name}__rosidl_typesupport_introspection_c" for name in DEPENDENCIES]
    libraries += ["rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c", "fastcdr", "rmw"]
    libraries += ["rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c", "rcutils"]
    folders = [f"-L{PREFIX / 'lib'}", f"-L{to.parent}", f"-Wl,-rpath,$ORIGIN:{PREFIX / 'lib'}"]
    names = ["-Wl,--no-as-needed", *(f"-l{library}" for library in [*own, *libraries])]
    command = ["g++", "-shared", "-o", str(to), f"-Wl,-soname,{to.name}", *objects, *folders, *names]
    subprocess.run(command, check=True)


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
