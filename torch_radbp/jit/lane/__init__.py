"""Functions of lanes: traced to programs, and written as LLVM's text."""
