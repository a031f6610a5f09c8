"""`python -m needle_rig` is the `needle-rig` command."""

from needle_rig.cli.main import main

if __name__ == "__main__":
    main()
