from omniman_ros.lab.bench import tracker as bench


def figures(**changes):
    found = {
        "velocity_rmse": 0.09,
        "walking_velocity_rmse": 0.1,
        "walking_missed_share": 0.01,
        "static_things": 100,
        "false_movers": 1,
        "crossings": 100,
        "identities_kept": 95,
        "cpu_share": 0.05,
    }
    return found | changes


def result(latency=50.0, node_share=0.1, **changes):
    times = {"median": 10.0, "p99": latency, "cpu_share": node_share}
    made = {"people": figures(**changes), "sudden": figures(velocity_rmse=0.3)}
    return made | {"crowd": figures(), "latency_ms": times}


def missed(found):
    return {name for name, is_met in bench.aims(found).items() if not is_met}


def test_a_missed_aim_is_reported_as_missed():
    assert missed(result()) == {"sudden_velocity"}
    assert missed(result(velocity_rmse=0.11)) == {"velocity", "sudden_velocity"}
    assert "false_movers" in missed(result(false_movers=2))
    assert "identity" in missed(result(identities_kept=94))
    assert "latency" in missed(result(latency=61.0))
    assert "cpu" in missed(result(node_share=0.26))
    found = result()
    found["aims"] = bench.aims(found)
    lines = bench.report(found)
    assert sum("MISSED" in line for line in lines) == 1
    assert any("turn on the spot" in line and "MISSED" in line for line in lines)
