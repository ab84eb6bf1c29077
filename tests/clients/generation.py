"""Lint the contract; generate a client in each language, compile it, and return the command that measures with it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.clients.tools import HERE, OPENAPI, WORK, CheckFailed, Tools, run

PROGRAMS = HERE / "programs"
_WARNING = re.compile(r"\b(warn(ings?)?|errors?|unable|unsupported)\b", re.IGNORECASE)
_NOTICES = (
    # What openapi-generator prints of every document of OpenAPI 3.1.
    "OpenAPI 3.1 support is still in beta",
    # And of every one with `additionalProperties: false`, which it takes for a schema and finds no name of.
    "Failed to get the schema name: null",
)


def lint(tools: Tools) -> None:
    """Run redocly's recommended rules and openapi-spec-validator; neither may find anything."""
    answer = run(
        [
            *(tools.command("redocly"), "lint", str(OPENAPI), "--config", str(HERE / "redocly.yaml")),
            *("--format", "json", "--max-problems", "1000"),
        ],
        environment={"REDOCLY_TELEMETRY": "off", "REDOCLY_SUPPRESS_UPDATE_NOTICE": "true"},
        may_fail=True,
    ).out
    found = json.loads(answer[answer.index("{") :])
    if any(found["totals"].values()):
        lines = [
            f"{p['ruleId']}: {p['message']} {p['location'][0].get('pointer')}" for p in found["problems"]
        ]
        raise CheckFailed("redocly finds:\n" + "\n".join(lines))
    _quiet([tools.command("openapi-spec-validator"), str(OPENAPI)])


def python_client(tools: Tools) -> list[str]:
    """Generate by openapi-python-client."""
    folder = _new_folder("python")
    _quiet(
        [
            *(tools.command("openapi-python-client"), "generate", "--path", str(OPENAPI)),
            *("--meta", "none", "--output-path", str(folder / "gridpose_client"), "--overwrite"),
            *("--config", str(HERE / "python.yaml"), "--fail-on-warning"),
        ],
        environment={"PATH": f"{tools.python.parent}:/usr/bin:/bin"},  # ruff, which formats what it writes
    )
    shutil.copy(PROGRAMS / "measure.py", folder / "measure.py")
    return [str(tools.python), "-W", "error", str(folder / "measure.py")]


def typescript_client(tools: Tools) -> list[str]:
    """Generate types by openapi-typescript for openapi-fetch; compile with all of tsc's strictness."""
    folder = _new_folder("typescript")
    (folder / "node_modules").symlink_to(tools.node_modules)
    _quiet([tools.command("openapi-typescript"), str(OPENAPI), "--output", str(folder / "gridpose.ts")])
    shutil.copy(PROGRAMS / "measure.ts", folder / "measure.ts")
    shutil.copy(HERE / "tsconfig.json", folder / "tsconfig.json")
    (folder / "package.json").write_text('{"type": "module"}\n', encoding="utf-8")
    _quiet([tools.command("tsc"), "--project", str(folder)])
    return ["node", str(folder / "out" / "measure.js")]


def java_client(tools: Tools) -> list[str]:
    """Generate by openapi-generator; compile against the libraries in its JAR and Debian's."""
    folder = _new_folder("java")
    options = {
        "library": "native",
        "openApiNullable": "false",
        "useJakartaEe": "true",
        "disallowAdditionalPropertiesIfNotPresent": "false",
        "hideGenerationTimestamp": "true",
        "invokerPackage": "org.gridpose",
        "apiPackage": "org.gridpose.api",
        "modelPackage": "org.gridpose.model",
    }
    _quiet(
        [
            *("java", "-jar", str(tools.generator_jar), "generate", "-g", "java", "-i", str(OPENAPI)),
            *("-o", str(folder / "client")),
            *("--additional-properties", ",".join(f"{name}={value}" for name, value in options.items())),
            *("--global-property", "apiTests=false,modelTests=false,apiDocs=false,modelDocs=false"),
        ]
    )
    sources = sorted(str(path) for path in (folder / "client" / "src" / "main" / "java").rglob("*.java"))
    classes = folder / "classes"
    arguments = folder / "arguments"
    arguments.write_text("\n".join([*sources, str(PROGRAMS / "Measure.java")]), encoding="utf-8")
    libraries = ":".join(map(str, tools.java_libraries))
    _quiet(["javac", "-Xlint:none", "-proc:none", "-cp", libraries, "-d", str(classes), f"@{arguments}"])
    return ["java", "-cp", f"{classes}:{libraries}", "Measure"]


def _new_folder(name: str) -> Path:
    folder = WORK / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _quiet(command: Sequence[str], **options: dict[str, str]) -> None:
    """Run a command that may not warn; CheckFailed with what it printed otherwise."""
    printed = run(command, environment=options.get("environment"))
    lines = [line for line in printed.out.splitlines() + printed.err.splitlines() if _WARNING.search(line)]
    lines = [line for line in lines if not any(notice in line for notice in _NOTICES)]
    if lines:
        raise CheckFailed(f"{' '.join(command[:3])} warns:\n" + "\n".join(lines) + f"\n{printed.out[-3000:]}")
