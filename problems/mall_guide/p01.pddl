; One visitor at the entrance, from where all that may be asked for can be seen. Should pointing
; or speaking fail, there is a screen at the desk.

(define (problem mall-guide-p01)
  (:domain mall_guide)

  (:objects
    pepper - robot
    visitor - person
    bakery pharmacy - shop
    fountain - landmark
    entrance desk - spot)

  (:init
    (at pepper entrance)
    (at visitor entrance)

    (way_between entrance desk) (way_between desk entrance)
    (screen_at desk)

    (visible bakery entrance)
    (visible pharmacy entrance)
    (visible fountain entrance)
    (near fountain bakery)
    (near fountain pharmacy)

    (may_want visitor bakery)
    (may_want visitor pharmacy))

  (:goal (guided visitor))

  (:metric minimize (total-time)))
