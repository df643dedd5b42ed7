"""Drive a running server over REST: wait until it is ready, look, and print the error to the goal.

longreach demo                                    # in another terminal; prints the address
python examples/07_rest_client.py http://127.0.0.1:8080
"""

import sys

import longreach

url = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8080"
with longreach.JobClient(url, owner="example") as client:
    client.wait_ready(20.0)
    print("mode:", client.state()["mode"])
    ended = client.run({"kind": "look"}, lambda event: print("  ", event["text"]))
    print(f"look: {ended.state} in {ended.elapsed_s:.1f} s {ended.reason}")
    error = (client.state()["look"] or {}).get("error")
    if error:
        print(f"tool minus goal: {error['x_mm']:+.1f} {error['y_mm']:+.1f} {error['z_mm']:+.1f} mm")
