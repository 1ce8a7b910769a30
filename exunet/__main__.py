"""`python -m exunet` is the `exunet` command."""

import sys


def main() -> None:
    """The command, clean also where Ctrl-C comes while it is still being imported."""
    try:
        from exunet.cli.main import main as command
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
