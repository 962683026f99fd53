"""Listings 1 and 2 of the paper, as they are printed."""

PAPER_DOMAIN = """\
...
actions:
 dummy_server:
  <<: *rpn_action
  params:
   - "value"
  effects:
   and:
    - Comparison: ["eq", [Query: "time", Query: "value"]]
    - not:
     Comparison: ["ne", [Query: "time", Query: "value"]]
 wait:
  <<: *ros_action
  params:
   - "time"
  preconditions:
   Exists: [Query: "time"]
...
"""
PAPER_PLAN = """\
initial_knowledge:
 value: 3
plan:
 - dummy_server: {}
 - concurrent_actions:
  - wait: {}
  - wait: {}
  - concurrent_actions:
   - wait: {time: 5}
   - wait: {time: 6}
"""
