"""The viewer: a page in the browser that displays the robot and commands it.

`page/` draws the page with viser and knows no ROS; `ros/` holds the topics, services and
parameters behind it; the modules beside them are plain numpy. `node.py` ties the three together.

How an event travels, with a goal that is dragged as the example:

1. `page/dragging.py`: viser calls `FloorDragging` in the server's thread, which converts the ray
   of the pointer into a position on the floor.
2. `page/draggable_markers.py`: the marker at that position posts a `GoalDragged` (`events.py`)
   into the queue of the node. Until the node confirms the new pose, the page displays it from
   `optimistic_updates.py`.
3. `node.py`: the timer `serve` empties the queue and passes each event to the handler of its type,
   which it looks up in one table.
4. `ros/pose_commands.py`: `PoseCommands.drag_goal` checks the pose and publishes `goal_pose`.

State travels the other way: the subscriptions of `ros/robot_topics.py` and
`ros/planner_topics.py` write into one `ViewState`, which the timer `draw` hands to `Page.draw`.
"""
