"""What brings work to the simulator and carries its results away."""
