"""``python -m fenics_joints``."""

from fenics_joints.cli import main

if __name__ == "__main__":
    main()
