"""Starting, supervising and stopping the nodes of a robot as child processes."""
