; Two robots and two visitors, at different ends of the mall. Anna has already said what she wants,
; and it is seen from nowhere: she needs the screen, or the lift that stands beside it. Ben is
; still to be asked. Each robot has its own voice and arm, so both talks go on at the same time.
;
;    entrance ---- desk ---- atrium ---- gallery ---- cafe (with a screen)
;        |                      |
;        '------- passage ------'

(define (problem mall-guide-p03)
  (:domain mall_guide)

  (:objects
    pepper nao - robot
    anna ben - person
    bakery bookshop toy_shop - shop
    fountain lift - landmark
    entrance desk passage atrium gallery cafe - spot)

  (:init
    (at pepper entrance)
    (at nao gallery)
    (at anna gallery)
    (at ben entrance)

    (way_between entrance desk)    (way_between desk entrance)
    (way_between desk atrium)      (way_between atrium desk)
    (way_between entrance passage) (way_between passage entrance)
    (way_between passage atrium)   (way_between atrium passage)
    (way_between atrium gallery)   (way_between gallery atrium)
    (way_between gallery cafe)     (way_between cafe gallery)
    (screen_at cafe)

    (visible bakery desk)
    (visible bookshop atrium)
    (visible fountain desk)
    (visible lift atrium)
    (near fountain bakery)
    (near lift bookshop)
    (near lift toy_shop)

    (wish_known anna)
    (wants anna toy_shop)
    (may_want ben bakery)
    (may_want ben bookshop))

  (:goal (and
    (guided anna)
    (guided ben)))

  (:metric minimize (total-time)))
