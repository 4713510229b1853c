"""House rules of writing kernels."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "tiswarm"
MOST_PARAMETERS = 10


def _kernel_functions():
    """Every function of a kernel, with its file."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                names = {ast.unparse(decorator) for decorator in node.decorator_list}
                if names & {"ti.func", "ti.kernel"}:
                    yield str(file.relative_to(PACKAGE)), node, "ti.kernel" in names


def test_kernel_functions_take_at_most_ten_arguments():
    """Only a kernel itself lists its arrays; functions take bundles of them."""
    long = [
        f"{file}: {node.name}"
        for file, node, is_kernel in _kernel_functions()
        if not is_kernel and len(node.args.args) > MOST_PARAMETERS
    ]

    assert long == []


def test_kernels_stand_in_files_named_for_them():
    """So that one pattern tells every checker which files hold kernels."""
    files = {file for file, _, _ in _kernel_functions()}

    assert {file for file in files if not file.endswith("kernels.py")} == set()
