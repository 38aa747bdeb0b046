"""Short programs that use the project; the guides are built around them, and the tests run them."""
