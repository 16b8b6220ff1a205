from torchid.dynamics.newton_euler import inverse_dynamics as inverse_dynamics
from torchid.dynamics.regressor import regressor as regressor
from torchid.errors import TorchidError as TorchidError
from torchid.export.export import export_dynamics as export_dynamics
from torchid.extraction.extract import extract as extract
from torchid.extraction.from_identification import problem_of as problem_of
from torchid.gap.diagnose import diagnose as diagnose
from torchid.identification.identify import identify as identify
from torchid.identification.settings import Settings as Settings
from torchid.log.model import Log as Log
from torchid.log.readers import read_log as read_log
from torchid.robot.inertia import InertialParameters as InertialParameters
from torchid.robot.library import load_robot as load_robot
from torchid.robot.model import Robot as Robot

__version__: str
