; The visitor waits at the entrance and may want one of two shops, which are seen neither from
; there nor from the desk: pepper goes to the visitor, asks, and leads the way to a better place to
; point from. Two ways lead there. The toy shop is seen from nowhere, but the lift beside it is.
;
;    entrance ---- desk ---- atrium ---- gallery ---- cafe (with a screen)
;        |                      |
;        '------- passage ------'

(define (problem mall-guide-p02)
  (:domain mall_guide)

  (:objects
    pepper - robot
    visitor - person
    bookshop toy_shop - shop
    fountain lift - landmark
    entrance desk passage atrium gallery cafe - spot)

  (:init
    (at pepper desk)
    (at visitor entrance)

    (way_between entrance desk)    (way_between desk entrance)
    (way_between desk atrium)      (way_between atrium desk)
    (way_between entrance passage) (way_between passage entrance)
    (way_between passage atrium)   (way_between atrium passage)
    (way_between atrium gallery)   (way_between gallery atrium)
    (way_between gallery cafe)     (way_between cafe gallery)
    (screen_at cafe)

    (visible bookshop atrium)
    (visible fountain desk)
    (visible lift atrium)
    (near lift bookshop)
    (near lift toy_shop)

    (may_want visitor bookshop)
    (may_want visitor toy_shop))

  (:goal (guided visitor))

  (:metric minimize (total-time)))
