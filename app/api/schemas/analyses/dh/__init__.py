"""The robot's kinematics as JSON: what was identified, its validation, and plans of poses."""
