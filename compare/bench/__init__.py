"""Speed over size: the ladder of sizes, and the process that times one of them."""
