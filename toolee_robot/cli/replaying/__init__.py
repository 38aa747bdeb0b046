"""`toolee replay` and `toolee runs`: what lies in `runs/`, and a look at one of them."""
