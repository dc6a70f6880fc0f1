"""Archives of diverse, robust 6-DoF grasps by distributed quality-diversity search."""
