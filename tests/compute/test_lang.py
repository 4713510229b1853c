"""House rules of writing kernels."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "tiswarm"
MOST_PARAMETERS = 10
NOT_YET_BUNDLED = {
    "localization/join_order_kernels.py",
    "localization/kernels.py",
    "world/join_kernels.py",
    "world/kernels.py",
    "world/meeting.py",
}
NOT_YET_RENAMED = {"world/meeting.py"}


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
    long = {
        file: node.name
        for file, node, is_kernel in _kernel_functions()
        if not is_kernel and len(node.args.args) > MOST_PARAMETERS
    }

    assert {file: name for file, name in long.items() if file not in NOT_YET_BUNDLED} == {}
    assert set(long) >= NOT_YET_BUNDLED


def test_kernels_stand_in_files_named_for_them():
    """So that one pattern tells every checker which files hold kernels."""
    files = {file for file, _, _ in _kernel_functions() if not file.endswith("kernels.py")}

    assert files == NOT_YET_RENAMED
