"""A plan that calls others, for tests that carry it out."""

from __future__ import annotations

GUIDE = """
actions:
  go: {params: [place], duration: 5}
  say: {type: kb_action}
outer:
  params: [shop]
  plan:
    - go: {place: door}
    - inner: {place: {LocalQuery: shop}}
    - say: {operation: {LocalUpdate: [heard, {LocalQuery: told}]}}
inner:
  params: [place]
  results: [told]
  timeout: 60
  plan:
    - say: {operation: {LocalUpdate: [secret, 1]}}
    - go: {}
    - say: {operation: {LocalUpdate: [told, {LocalQuery: place}]}}
"""
