"""CoACD and V-HACD, each in a child process that may crash, hang or run out of memory without harm."""
