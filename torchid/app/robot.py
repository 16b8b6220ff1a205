"""`torchid robot`: what a robot description says."""

from torchid.app.options import Json, Out, Quiet, RobotArgument, Tip
from torchid.app.output import open_output


def robot_command(
    robot: RobotArgument,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Print joints, limits, parameters and warnings of a robot.

    Example: `torchid robot kuka_lwr4`
    """
    output = open_output(json_file, out, quiet)
    from torchid.report.robot import robot_record, robot_tables
    from torchid.robot.library import load_robot

    found = load_robot(robot, tip=tip)
    for table in robot_tables(found):
        output.say(table)
    data = robot_record(found)
    output.warn(tuple(data["warnings"]))
    output.write_json(data, "robot.json")
