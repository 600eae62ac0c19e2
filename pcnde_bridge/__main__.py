"""``python -m pcnde_bridge``: the command line."""

from pcnde_bridge.cli.main import run

if __name__ == "__main__":
    run()
