from .completion import complete_cloud as complete_cloud
from .depth_files import load_depth_image as load_depth_image
from .depth_files import save_depth_image as save_depth_image
from .known_objects import Explanation as Explanation
from .known_objects import KnownObject as KnownObject
from .observer import ObserverSettings as ObserverSettings
from .observer import SceneObserver as SceneObserver
from .occlusion import (
    Occlusion as Occlusion,
)
from .occlusion import (
    robot_depth as robot_depth,
)
from .occlusion import (
    robot_mask as robot_mask,
)
from .occlusion import (
    view_is_clear as view_is_clear,
)
from .registration import (
    Alternative as Alternative,
)
from .registration import (
    Registration as Registration,
)
from .registration import (
    RegistrationSettings as RegistrationSettings,
)
from .registration import (
    register as register,
)
from .scene_registration import RegisteredSegment as RegisteredSegment
from .scene_registration import register_scene as register_scene
from .scene_state import SceneEvent as SceneEvent
from .scene_state import SceneEventKind as SceneEventKind
from .scene_state import SceneState as SceneState
from .scoring import add_s as add_s
from .search import SearchSettings as SearchSettings
from .segmentation import (
    DroppedCluster as DroppedCluster,
)
from .segmentation import (
    Segmentation as Segmentation,
)
from .segmentation import (
    SegmentationSettings as SegmentationSettings,
)
from .segmentation import (
    segment_image as segment_image,
)
from .segments import (
    Segment as Segment,
)
from .segments import (
    joined_segments as joined_segments,
)
from .segments import (
    segment_from_pixels as segment_from_pixels,
)
from .segments import (
    split_at_creases as split_at_creases,
)
from .templates import (
    Template as Template,
)
from .templates import (
    catalogue_template as catalogue_template,
)
from .templates import (
    catalogue_templates as catalogue_templates,
)
from .templates import (
    template_from_file as template_from_file,
)
from .templates import (
    template_from_mesh as template_from_mesh,
)
from .tracking import ExpectedVisibility as ExpectedVisibility
