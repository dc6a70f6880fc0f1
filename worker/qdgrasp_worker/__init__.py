"""The worker: evaluates grasps in a simulator for the jobs on a bus."""
