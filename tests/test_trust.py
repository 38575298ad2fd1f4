"""No file that the project reads can run code, but for one kind of policy that has to be trusted."""

import ast
import re

import pytest

from tests.test_imports import MODULES

NEVER_IMPORTED = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
# A call, as it is written, and what makes it harmless.
CALLS = {
    r"(eval|exec|compile|__import__)\(": None,
    r"yaml\.(load|unsafe_load|full_load)(_all)?\(": "SafeLoader",
    r"(torch|th)\.load\(": "weights_only=True",
    r"torch\.(jit|package|hub)\.": None,
    r"np\.(load|save\w*)\(.*allow_pickle=True": None,
    r"pd\.read_pickle\(": None,
    r"(BaseAlgorithm|ActorCriticPolicy|\w*PPO|VecNormalize|getattr\(.*\))\.load\(": None,
    r"model\.save\(": None,
    r".*\bshell=True": None,
}
# Policies of stable-baselines3 are pickles; `--trust` stands before them.
TRUSTED = {
    ("env.driving.pickled_policies", "getattr(package, algorithm.name).load(path, device='cpu')"),
    ("env.driving.pickled_policies", "VecNormalize.load(str(file), nowhere)"),
}


# Files are read through sfol.reading and written through sfol.writing, which yields a `part`.
OPENERS = {"open", "read_bytes", "read_text", "write_bytes", "write_text"}
OWN_FILES = r"part\.|files\('[\w.]+'\)\.joinpath\("
OPEN_THEMSELVES = {
    "sfol.reading": {"path.open('rb')"},
    "sfol.writing": {
        "os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 438)",
        "os.open(path, os.O_APPEND | os.O_CREAT | os.O_WRONLY | os.O_NOFOLLOW, 438)",
        "open(descriptor, 'a', encoding='utf-8')",
    },
    "sfol.locking": {"os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 438)"},
    "sfol.cli.output": {"os.open(os.devnull, os.O_WRONLY)"},
    "sfol.tools.committed": {  # a temporary folder
        "Path(copy, name).write_bytes(_git(file.parent, 'cat-file', 'blob', digest))"
    },
    "vsr.tensor_files": {"stack.enter_context(replacing(path)).write_bytes(content)"},
    "env.study.figures.style": {"Image.open(drawn)"},  # in memory
    "env.driving.pickled_policies": {"archive.open('data')"},  # in an archive that is open already
    "env.evaluation.worker_imports": {"os.open(os.devnull, os.O_WRONLY)"},
    "env.tools.bench": {  # of the system
        "Path(f'/proc/{process.pid}/smaps_rollup').read_text()"
    },
}


def calls(tree):
    return [ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Call)]


def dangerous(call):
    """Tell whether a call may run what it reads."""
    return any(
        re.match(pattern, call) and (safe is None or safe not in call)
        for pattern, safe in CALLS.items()
    )


@pytest.mark.parametrize("name", MODULES)
def test_nothing_that_is_read_is_run(name):
    tree = ast.parse(MODULES[name].read_text())
    imported = {
        alias.name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    } | {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not NEVER_IMPORTED & imported
    found = {(name, call) for call in calls(tree) if dangerous(call)}
    assert found <= TRUSTED


def test_the_exceptions_are_those_that_there_are():
    for name, call in TRUSTED:
        assert call in calls(ast.parse(MODULES[name].read_text()))
        assert dangerous(call)


@pytest.mark.parametrize("name", MODULES)
def test_files_go_through_one_opener_and_one_writer(name):
    tree = ast.parse(MODULES[name].read_text())
    opened = {
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and (getattr(node.func, "id", None) or getattr(node.func, "attr", None)) in OPENERS
    }
    themselves = {call for call in opened if not re.match(OWN_FILES, call)}
    assert themselves == OPEN_THEMSELVES.get(name, set())


@pytest.mark.parametrize(
    "call",
    [
        "eval('1')",
        "torch.load(file)",
        "PPO.load(file)",
        "FinitePPO.load(file)",
        "VecNormalize.load(file, streets)",
        "np.load(file, allow_pickle=True)",
        "yaml.load(text, Loader)",
        "subprocess.run(words, shell=True)",
    ],
)
def test_what_may_run_code_is_found(call):
    assert dangerous(call)


@pytest.mark.parametrize(
    "call", ["torch.load(file, weights_only=True)", "np.load(file)", "network.eval()"]
)
def test_what_runs_none_is_left_alone(call):
    assert not dangerous(call)
