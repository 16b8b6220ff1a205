"""An arm that torchid has never seen: the benchmark's own simulator and generator of cases.

Nothing here comes from torchid's dynamics or effects. MuJoCo moves the arm; effects are what they
would be on an arm (a second mass, bristles, a heated gear, a wrong encoder), not columns.

A case is drawn (`draw`, with the numbers of `settings`) and simulated (`case`). Drives are told
torques (`scene`, `simulate`, effects in `catalogue`) or are servos that take set-points
(`servo_scene`, `servo`, `servo_catalogue`); keys are the same.
"""
