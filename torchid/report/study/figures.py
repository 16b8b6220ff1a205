"""Every figure of a study."""

from torchid.report.study.drawing import Drawing, save
from torchid.report.study.motion_figures import motion_drawings
from torchid.report.study.payload_figures import payload_drawings
from torchid.report.study.search_figures import search_drawings
from torchid.report.study.torque_figures import torque_drawings
from torchid.report.study.wrench_figures import wrench_drawings
from torchid.study.result import Study

__all__ = ["Drawing", "drawings", "save"]


def drawings(study: Study) -> list[Drawing]:
    """Figures with captions, none of them drawn yet (figures 5.1 to 5.19, and more)."""
    return [
        *motion_drawings(study),
        *torque_drawings(study),
        *search_drawings(study),
        *wrench_drawings(study),
        *payload_drawings(study),
    ]
