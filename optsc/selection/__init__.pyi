from .costs import (
    ClearanceLoss as ClearanceLoss,
)
from .costs import (
    GraspCost as GraspCost,
)
from .costs import (
    JointTravel as JointTravel,
)
from .costs import (
    ManipulabilityLoss as ManipulabilityLoss,
)
from .costs import (
    OrientationDistance as OrientationDistance,
)
from .costs import (
    PathClearanceLoss as PathClearanceLoss,
)
from .costs import (
    PathLength as PathLength,
)
from .costs import (
    PathManipulabilityLoss as PathManipulabilityLoss,
)
from .costs import (
    PathSpeed as PathSpeed,
)
from .costs import (
    PoseDistance as PoseDistance,
)
from .costs import (
    PositionDistance as PositionDistance,
)
from .costs import (
    QualityLoss as QualityLoss,
)
from .costs import (
    TableCost as TableCost,
)
from .explanation import CandidateRow as CandidateRow
from .filters import (
    AtMost as AtMost,
)
from .filters import (
    GraspFilter as GraspFilter,
)
from .filters import (
    StraightPathFilter as StraightPathFilter,
)
from .filters import (
    Vetoed as Vetoed,
)
from .hysteresis import Hysteresis as Hysteresis
from .ranking import Ranking as Ranking
from .ranking import Target as Target
from .reach import ReachSolver as ReachSolver
from .reach import ReachTable as ReachTable
from .reach_columns import StraightMotion as StraightMotion
from .rules import (
    Cascade as Cascade,
)
from .rules import (
    Lexicographic as Lexicographic,
)
from .rules import (
    RankingRule as RankingRule,
)
from .rules import (
    Stage as Stage,
)
from .rules import (
    WeightedSum as WeightedSum,
)
from .selector import GraspSelector as GraspSelector
