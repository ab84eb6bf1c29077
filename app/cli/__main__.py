"""`python -m app.cli`: the `gridpose` command where its script is not at hand."""

from app.cli.main import main

if __name__ == "__main__":
    main()
