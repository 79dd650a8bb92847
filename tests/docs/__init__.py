"""What stands in the documentation is true: blocks of code, links, tutorials, notebooks."""
