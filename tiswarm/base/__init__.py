"""What every room uses: errors, checks of parameters, progress, the version, a robot's docks."""
