"""Scripts that fit with mujoco.sysid say what to install where it is not whole."""

import sys
from types import ModuleType

import pytest

from torchid.errors import TorchidError
from torchid_bench.benchmarks.runner import command
from torchid_bench.benchmarks.sysid_toolbox import ANEW, EXTRA, sysid_toolbox


def module(name: str, **has: object) -> ModuleType:
    out = ModuleType(name)
    vars(out).update(has)
    return out


NOT_WHOLE = {
    "none": (None, EXTRA),
    "broken": (module("mujoco"), ANEW),
    "old": (module("mujoco", MjModel=object, __version__="3.2.0"), ANEW),
    "without its extra": (
        module("mujoco", MjModel=object, __version__="4.0.0", sysid=module("sysid")), EXTRA
    ),
}  # fmt: skip


def of_sysid() -> None:
    sysid_toolbox()


@pytest.mark.parametrize("case", NOT_WHOLE)
def test_a_toolbox_that_is_not_whole_names_the_line(
    case: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mujoco, line = NOT_WHOLE[case]
    monkeypatch.setitem(sys.modules, "mujoco", mujoco)
    monkeypatch.delitem(sys.modules, "mujoco.sysid", raising=False)
    with pytest.raises(TorchidError) as refused:
        sysid_toolbox()
    assert refused.value.hint == f"paste: {line}"
    with pytest.raises(SystemExit) as ended:
        command(of_sysid, words=[])
    assert str(ended.value).startswith("error: ")
    assert line in str(ended.value)


def test_lost_core_files_are_installed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """As MuJoCo 4.0 says it after an upgrade in its place."""

    class Broken:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "mujoco":
                raise ImportError("its core bindings ('mujoco-core') are missing or corrupted")

    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with pytest.raises(TorchidError) as refused:
        sysid_toolbox()
    assert refused.value.hint == f"paste: {ANEW}"


def test_a_whole_toolbox_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    sysid = module("sysid", optimize=print)
    whole = module("mujoco", MjModel=object, __version__="4.0.0", sysid=sysid)
    monkeypatch.setitem(sys.modules, "mujoco", whole)
    monkeypatch.setitem(sys.modules, "mujoco.sysid", sysid)
    assert sysid_toolbox() is sysid
