"""Colours of the page and of the scene, and sizes of the panels."""

Colour = tuple[int, int, int]  #: Red, green and blue, 0 to 255, as the 3D scene uses them


def rgb(code: str) -> Colour:
    """Convert a colour of HTML, `#rrggbb`, to one of the scene."""
    red, green, blue = bytes.fromhex(code.removeprefix("#"))
    return red, green, blue


GREEN, DARK_ORANGE, RED, BLUE = "#2b8a3e", "#b35c00", "#c92a2a", "#1864ab"
GRAY, DARK_GRAY, TEAL = "#868e96", "#495057", "#0c8599"

GOOD = GREEN  #: Colour of a state that is as it should be
WARNING = DARK_ORANGE  #: Colour of a warning
BAD = RED  #: Colour of an error or a stop
MUTED = GRAY  #: Colour of labels and hints
PROMINENT = BLUE  #: Colour of the advice to a first-time user

#: Colours of the curves of a plot, in order
SERIES = ("#1971c2", "#e8590c", "#2f9e44", "#9c36b5", "#c2255c", TEAL, "#5c940d", DARK_GRAY)
#: Colour of the lines that mark a limit in a plot
LIMIT = "#e03131"

#: Colour of the reference, of the arrow on the deck and of the marks on the wheels
ACCENT = rgb("#fd7e14")
#: Colour of the true pose of a simulated robot
GHOST = rgb("#228be6")
PATH = rgb(GREEN)
PLAN = rgb("#d6249f")
PREDICTED = rgb("#d6a078")
ROUTE = rgb("#9775fa")
TOOL_PATH = rgb(TEAL)
TRAIL = rgb(DARK_GRAY)
WORKSPACE = rgb(GRAY)
SCAN = rgb("#e03131")
TRACK = rgb("#0b7285")
NEAREST = rgb("#f76707")
FOOTPRINT = rgb("#7048e8")
GRID_CELL = rgb("#dee2e6")
GRID_SECTION = rgb("#bec4ca")

DECK = rgb("#adb5bd")
CHASSIS = rgb(DARK_GRAY)
RUBBER = rgb("#262a2e")
WHEEL_PLATES = rgb("#ced4da")
ARM_TUBES = rgb("#d6dbe0")
ARM_CAPS = rgb("#266cc4")
ARM_FOOT = rgb(GRAY)

START = rgb("#c91818")
GOAL = rgb("#104acc")
VELOCITY_SHAFT = rgb("#693218")
OBSTACLE_PATH = rgb("#c83408")
# The next seven are colours of batches, which viser renders lighter than the same colours of other
# meshes.
PLACED_OBSTACLE = rgb("#c83408")
SELECTED_OBSTACLE = rgb("#ff9600")
OTHER_OBSTACLE = rgb("#3a2012")
VELOCITY_ARROW = rgb("#2c0c04")
WAYPOINT = rgb("#c83408")
CAPSULE = rgb("#5028b0")
CONTACT = rgb("#c00000")

PANEL_WIDTH = 310.0  #: Width of the panels at either side [px]
STOP_PANEL_HEIGHT = 100  #: Height of the panel with Stop and Reset [px]
DRIVE_PANEL_HEIGHT = 180  #: Height of the panel with the motion buttons [px]
STATE_PANEL_HEIGHT = 270  #: Height of the panel with the state in words [px]
PLOT_HEIGHT = 104  #: Height of a plot [px]: three of them fit below each other on a small screen
