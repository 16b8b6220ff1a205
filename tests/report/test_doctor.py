"""What an examination says and what its picture says."""

from tests.doctor.synthetic import clean
from torchid.doctor.examine import examine
from torchid.report.doctor import torque_figure


def test_the_picture_has_the_shares_of_the_table() -> None:
    robot, log = clean("panda", 0)
    found = examine(robot, log.replace(tau=log.tau.flip(-1)), first=True)
    (evidence,) = (c.evidence for c in found.checks if c.name == "torque explained")
    figure = torque_figure(found)
    assert figure is not None
    for k, axes in enumerate(figure.axes):
        share = axes.get_ylabel().split("\n")[1].removesuffix(" left")
        assert f"{share} (joint {k + 1})" in evidence
