"""`torchid robot`: what a robot description says."""

from torchid.app import options as opt
from torchid.app.output import open_output


def robot_command(
    robot: opt.RobotArgument,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    quiet: opt.Quiet = False,
) -> None:
    """Print joints, limits, parameters and warnings of a robot.

    Example: `torchid robot kuka_lwr4`
    """
    output = open_output(json_file, out, quiet)
    from torchid.report.robot import robot_record, robot_tables
    from torchid.robot.library import load_robot

    found = load_robot(robot, tip=tip)
    output.say(*robot_tables(found))
    data = robot_record(found)
    output.warn(tuple(data["warnings"]))
    output.write_json(data, "robot.json")
