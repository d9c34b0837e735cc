"""``python -m tactape_fab.cli``."""

from tactape_fab.cli import main

if __name__ == "__main__":
    main()
