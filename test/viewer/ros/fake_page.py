"""A page whose buttons a test presses, and the viewer's node with it in a world."""

from functools import partial

from std_srvs.srv import Trigger

from omniman_ros.viewer.events import ButtonPressed
from omniman_ros.viewer.node import ViewerNode
from test.nodes.harness import World


class FakePage:
    """The interface of a page that the node uses."""

    def __init__(self, robot, mount, constraints, limits, access, post):
        self.mount = mount
        self.made_with = (constraints, limits, access.host, access.port)
        self.address = self.link = f"http://{access.host}:{access.port}"
        self.post = post
        self.speeds = (0.4, 0.8)
        self.watched = True
        self.layers = frozenset()
        self.frames = []
        self.statuses = []
        self.closed = False

    def draw(self, state, now):
        self.frames.append(now)

    def draw_status(self, state, now):
        self.statuses.append((state.pace, state.awaited))

    def close(self):
        self.closed = True


def view(*others, parameters=None):
    """Return a world with the viewer as its last node."""
    return World(*others, partial(ViewerNode, make_page=FakePage), parameters=parameters)


def press(world, action, seconds=0.5):
    """Press a button of the viewer's page, and let time pass."""
    post(world, ButtonPressed(action), seconds=seconds)


def post(world, *events, seconds=0.1):
    """Post events of the viewer's page, and let time pass."""
    for event in events:
        world.nodes[-1].page.post(event)
    world.run(seconds)


def until(world, condition, what, step=0.05):
    """Let time pass until a condition holds that needs the middleware (discovery, services)."""
    world._await(lambda: (world.run(step), condition())[1], what)


class Services:
    """Trigger services of a node; `called` lists the actions called."""

    def __init__(self, world, node, *actions, refuses="", why="not now"):
        self.called = []
        self._why = why
        for action in actions:
            world.probe.create_service(Trigger, f"{node}/{action}", self._answer(action, refuses))

    def _answer(self, action, refuses):
        def answer(request, response):
            self.called.append(action)
            response.success = action != refuses
            response.message = self._why if action == refuses else ""
            return response

        return answer
