"""``python -m pcnde_bridge``: the command line."""

from pcnde_bridge.cli import main

if __name__ == "__main__":
    main()
