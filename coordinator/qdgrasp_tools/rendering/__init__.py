"""Pictures of hands, objects and grasps, cast ray by ray and annotated."""
