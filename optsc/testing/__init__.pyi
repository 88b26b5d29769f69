from .contract import Contract as Contract
from .costs import GraspCostContract as GraspCostContract
from .costs import GraspFilterContract as GraspFilterContract
from .followers import FollowerContract as FollowerContract
from .operators import OperatorContract as OperatorContract
from .policies import ArbitrationContract as ArbitrationContract
