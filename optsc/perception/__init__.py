"""What a depth camera sees: objects apart from table and arm, whether the arm hides them, and what they are."""

from optsc.perception.completion import complete_cloud
from optsc.perception.depth_files import load_depth_image, save_depth_image
from optsc.perception.known_objects import Explanation, KnownObject
from optsc.perception.observer import ObserverSettings, SceneObserver
from optsc.perception.occlusion import Occlusion, robot_depth, robot_mask, view_is_clear
from optsc.perception.registration import Alternative, Registration, RegistrationSettings, register
from optsc.perception.scene_registration import RegisteredSegment, register_scene
from optsc.perception.scene_state import SceneEvent, SceneEventKind, SceneState
from optsc.perception.scoring import add_s
from optsc.perception.search import SearchSettings
from optsc.perception.segmentation import DroppedCluster, Segmentation, SegmentationSettings, segment_image
from optsc.perception.segments import Segment, joined_segments, segment_from_pixels, split_at_creases
from optsc.perception.templates import (
    Template,
    catalogue_template,
    catalogue_templates,
    template_from_file,
    template_from_mesh,
)
from optsc.perception.tracking import ExpectedVisibility

__all__ = [
    "Alternative",
    "DroppedCluster",
    "ExpectedVisibility",
    "Explanation",
    "KnownObject",
    "ObserverSettings",
    "Occlusion",
    "RegisteredSegment",
    "Registration",
    "RegistrationSettings",
    "SceneEvent",
    "SceneEventKind",
    "SceneObserver",
    "SceneState",
    "SearchSettings",
    "Segment",
    "Segmentation",
    "SegmentationSettings",
    "Template",
    "add_s",
    "catalogue_template",
    "catalogue_templates",
    "complete_cloud",
    "joined_segments",
    "load_depth_image",
    "register",
    "register_scene",
    "robot_depth",
    "robot_mask",
    "save_depth_image",
    "segment_from_pixels",
    "segment_image",
    "split_at_creases",
    "template_from_file",
    "template_from_mesh",
    "view_is_clear",
]
