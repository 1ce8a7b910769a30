"""What accuracy costs in time: methods and settings on one scene, against a solution that proves itself."""
