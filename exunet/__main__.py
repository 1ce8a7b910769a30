"""`python -m exunet` is the `exunet` command."""

from exunet.cli import main

main()
