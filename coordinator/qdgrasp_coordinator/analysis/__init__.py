"""What a finished or running run amounts to: coverage of a reference set, and a picture of its grasps."""
