"""Domains and plans in YAML: listings 1 and 2 of the paper as they are printed, and others that several tests use."""

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


PDDL = """\
name: homes
requirements: [typing, durative-actions]
types: [kitchen hall - place, robot drone - thing]
constants: base - hall
predicates:
  - (at ?t - thing ?p - place)
  - (free ?t - thing)
  - (home ?t - thing)
functions:
  - (battery ?t - thing)
  - (owner ?t - thing) - thing
derived:
  - fact: (home ?t - thing)
    condition: (at ?t base)
constraints: [whatever planners read]
preferences: [whatever planners read]
hierarchy: [whatever planners read]
actions:
  move:
    params: "?t - thing ?from ?to - place"
    duration: {Operation: ["/", [10, "(battery ?t)"]]}
    preconditions:
      at_start: ["(at ?t ?from)", {not: "(home ?t)"}]
      over_all: {Comparison: [">", ["(battery ?t)", 0]]}
      at_end: (free ?t)
    effects:
      at_start: {not: "(at ?t ?from)"}
      at_end: ["(at ?t ?to)", {decrease: ["(battery ?t)", "?duration"]}, {Exists: [Query: distance]}]
    resources: [floor]
    retries: 2
    timeout: 30
    server: "/{t}/move"
    ros_type: nav2_msgs/action/NavigateToPose
    goal: {to: "?to", speed: 0.5}
    store: {distance: driven}
    ask: {speed: "How fast?"}
problem:
  name: home
  objects: [r1 - robot, k1 k2 - kitchen]
  init:
    - (at r1 k1)
    - (= (battery r1) 80)
    - (= (owner r1) r1)
    - (not (free r1))
    - {at: 7.5, facts: [(free r1), (= (battery r1) 3)]}
    - {at: 5, facts: (not (at r1 k1))}
  goal: (home r1)
  metric: whatever planners read
"""


RECIPES = """\
actions: {a: , b: {type: kb_action}}
first:
  server: {module: actionlib, class: ActionServer}
  action: {module: rpn_recipe_planner_msgs.msg, class: RosServerAction}
  initial_knowledge: {value: 5}
  plan:
    - a: {}
    - while:
        condition: {Comparison: ["ne", [LocalQuery: "value", 10]]}
        actions:
          - a:
          - b: {operation: {LocalUpdate: ["value", {LocalQuery: "result"}, ""]}}
second:
  server: {module: any_plugin_server, class: DAPluginServer}
  plan: []
"""


RECOVERING = """\
actions:
  move:
    params: "?r"
    recoveries:
      during:
        aborted: [{say: {text: [stuck, "?r"]}}, retry]
        preempted: fail
  say: {params: [text]}
  beep:
restarts: 4
plan:
  - move: {r: r1}
  - move: {r: {Query: robot}}
  - move:
  - move:
    recoveries:
      before:
        - {when: {Query: tired}, do: [beep: , skip_action], times: 2}
        - {do: [restart_plan]}
      during: {lost: {do: [beep: , say: {text: "?r"}, replan], times: 5}, timed_out: continue}
      after: [restart_action]
  - move:
    recoveries: {}
"""
