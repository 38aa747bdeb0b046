"""URScript: tokeniser, parser, compiler to Python generators, and the scheduler of a program's threads."""
