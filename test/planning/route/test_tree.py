import heapq

import numpy as np

from omniman_ros.planning.route.tree import BAND, Queue, Tree

OFFSETS = np.array([0, 1, 10, -1, -10])
HEADINGS = 8


def put(tree, node, heading, cost, way, side):
    ids = tree.ids(np.array([node]), np.array([heading]))
    moves = np.array([3 * way + side], dtype=np.int8)
    return ids, tree.put(ids, np.array([cost], dtype=np.float32), moves)


def test_states_keep_numbers_and_costs_when_the_memory_grows():
    tree = Tree(5000, HEADINGS)
    rng = np.random.default_rng(1)
    nodes, headings = rng.permutation(5000), rng.integers(HEADINGS, size=5000)
    costs = rng.uniform(0, 9, 5000).astype(np.float32)
    ids = tree.ids(nodes[:500], headings[:500])
    tree.begin(ids, costs[:500])
    rest = tree.ids(nodes[500:], headings[500:])
    tree.begin(rest, costs[500:])
    np.testing.assert_array_equal(tree.ids(nodes[:500], headings[:500]), ids)
    every = np.concatenate([ids, rest])
    assert len(np.unique(every)) == 5000
    np.testing.assert_array_equal(tree.cost[every], costs)
    np.testing.assert_array_equal(tree.places(every), [nodes, headings])
    assert np.isinf(tree.cost).sum() == len(tree.cost) - 5000


def test_only_a_lower_cost_replaces_a_parent():
    tree = Tree(100, HEADINGS)
    tree.begin(tree.ids(np.array([44]), np.array([0])), np.zeros(1, dtype=np.float32))
    put(tree, 45, 7, 1.0, 1, 0)  # forward by a column, back by a heading
    state, won = put(tree, 55, 7, 3.0, 2, 1)
    assert won.all()
    put(tree, 54, 7, 1.5, 2, 0)
    assert not put(tree, 55, 7, 3.5, 1, 1)[1].any()
    nodes, headings = tree.back(int(state[0]), OFFSETS)
    assert (nodes.tolist(), headings.tolist()) == ([44, 45, 55], [0, 7, 7])
    assert put(tree, 55, 7, 2.5, 1, 1)[1].all()
    nodes, headings = tree.back(int(state[0]), OFFSETS)
    assert (nodes.tolist(), headings.tolist()) == ([44, 54, 55], [0, 7, 7])


def test_queue_yields_bands_in_order_and_the_nearest_of_each_first():
    rng = np.random.default_rng(3)
    order, guess = rng.uniform(0, 2, (2, 300)).astype(np.float32)
    ids, least = np.arange(300), rng.uniform(0, 1, 300).astype(np.float32)
    queue = Queue()
    for k in range(0, 300, 50):
        part = slice(k, k + 50)
        queue.push(order[part], guess[part], ids[part], least[part])
    band = (order / BAND).astype(int)
    expected = [(int(b), float(g), int(i)) for b, g, i in zip(band, guess, ids, strict=True)]
    heapq.heapify(expected)
    while queue:
        rank = round(queue.rank / BAND)
        got = queue.pop(4, least)
        assert 0 < len(got) <= 4
        nearest = [heapq.heappop(expected) for _ in got]
        assert {b for b, _, _ in nearest} == {rank}
        assert sorted(got) == sorted(i for _, _, i in nearest)
    assert not expected


def test_entry_with_a_better_path_since_is_dropped():
    queue, ids = Queue(), np.array([3, 5])
    cost = np.array([1, 2], dtype=np.float32)
    queue.push(cost * 0, cost, ids, cost)
    least = np.full(9, np.inf, dtype=np.float32)
    least[ids] = 1.0, 1.5
    assert queue.pop(9, least).tolist() == [3]
    assert not queue
